"""A robot that drives through the onboard loop, over simulated ground with obstacles."""
