"""The vehicle: its rigid body, what disturbs it, what is measured of it, how far it can turn in a tick."""
