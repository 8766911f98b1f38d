"""The forces on a superbike, one subject a module; `bike_sim.physics.superbike.forces` puts them together."""
