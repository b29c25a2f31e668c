"""petscjam: the linear response of jammed packings at every frequency, on PETSc.

Nothing heavy is imported until it is used.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
