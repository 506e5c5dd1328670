"""Losses, regularisers, schedules and the optimisation loop."""

from .fit import Fit as Fit
from .fit import FitResult as FitResult
from .fit import fit as fit
