"""Where the loop's inputs come from and its answers go: stdio, Zenoh, recordings, an MCAP log,
rerun.
"""
