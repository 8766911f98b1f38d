"""The forces on a superbike, one subject a module; `bike_sim.physics.superbike_forces` puts them together."""
