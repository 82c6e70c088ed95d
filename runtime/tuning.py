"""Every number that steers a search, a region or a planner's choice: value, unit, why, and the figure that chose it."""

MOST_LOGGED_CHANGES = 64
"""Changes of a map that wait for a reader unmerged. More would let a reader that is never asked hold memory; with
fewer, merged rectangles cover much that did not change."""
