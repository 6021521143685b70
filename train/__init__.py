"""Learning followers: needs the `train` extra. May import `baselines` and `formation_env`."""
