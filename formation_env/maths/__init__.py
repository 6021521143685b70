"""Vectors and rotations, elementary functions, the Runge-Kutta step and random numbers."""
