"""The onboard loop on a robot: `transports` carry its messages, `operations` start it and watch
over it.
"""
