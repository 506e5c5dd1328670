"""Losses, regularisers, schedules and the optimisation loop."""

from .fit import Fit as Fit
from .loop import FitResult as FitResult
from .loop import Run as Run
from .loop import fit as fit
