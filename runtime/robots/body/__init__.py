"""Robots with a body: every pose is checked on the ground."""
