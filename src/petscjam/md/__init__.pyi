from .oscillations import harmonics as harmonics
from .result import Run as Run
from .result import read as read
from .runs import ramp as ramp
from .runs import run as run
from .runs import shear as shear
