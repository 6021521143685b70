"""Trajectories of the leader: derivatives in kernels, tables, random ones, and the object."""
