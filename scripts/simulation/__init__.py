"""The parts of simulate_recordings.py: places, traffic, the tracks of it, and the maps, each from a seed."""
