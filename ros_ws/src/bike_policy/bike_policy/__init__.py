"""Policies that steer: the contract of observation and action, the actor, its bundle, and the node that drives."""
