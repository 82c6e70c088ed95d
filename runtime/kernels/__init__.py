"""The kernels: arrays in, numbers out. No checks, no objects, no allocation beyond what a line
says.

What belongs together is a record of `records.py`, which gives each field's unit and shape. It is
handed over as a plain tuple (0.2 µs a call, where a NamedTuple would take 4), and named by the
annotation of a kernel's parameter, ``memory: Memory``, which is free.

Modules in here import each other and nothing else of the project but the decorator: the folder of
compiled kernels is named after these files alone, so that a change elsewhere leaves them compiled.
"""
