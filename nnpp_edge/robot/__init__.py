"""The onboard loop on a robot: transports, logs, views, operations."""
