"""A tuning for a bus, actuators, noise and a box of cars."""
