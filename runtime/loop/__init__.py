"""The onboard loop: inputs in, a checked path out, at a fixed rate. See docs/onboard.md."""
