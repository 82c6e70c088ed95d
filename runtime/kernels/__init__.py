"""The kernels: arrays in, numbers out. No checks, no objects, no allocation beyond what a line
says.

What belongs together is handed over as one plain tuple, in this order everywhere:

- ``grid``: (weights, stride, steps, corner_cutting), `map.grid.Grid.packed`. The weights have a
  border of impassable
  cells; `stride` nodes lie from one row to the next; `steps` are the lengths, then the weight
  factors of a straight and of a diagonal step.
- ``region``: (bitmap, row_block, col_block, stamp), `search.region.Region`; None for the whole map.
- ``memory``: the scratch arrays of a search, `Workspace.packed` and its like, listed where they are
  unpacked.
- ``area``: (row0, row1, col0, col1), rows and columns from the first up to but not including the
  second.

Plain tuples, as a call with NamedTuples takes 3.9 µs longer than one with the same arrays one by
one, and with plain tuples 0.2 µs.

Modules in here import each other and nothing else of the project but the decorator: the folder of
compiled kernels is named after these files alone, so that a change elsewhere leaves them compiled.
"""
