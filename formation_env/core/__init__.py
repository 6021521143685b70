"""Many worlds: their arrays, the loops of a tick and its order, the kernels, and `Simulation`."""
