"""The robot's own part: cost map, network, search, loop. Needs numpy, numba, onnxruntime and
nothing of training.

Everything for users can be imported from here: the names in `__init__.pyi`, which type checkers
read too. A name is loaded when it is first used, so that a command which needs none of them starts
at once.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
