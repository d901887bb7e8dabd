"""Fits analytic BRDF models to tables: the models, the objectives, the search, the account."""

from fitting.fit import fit
from fitting.models import MODELS
from fitting.result import Fit
from fitting.samples import Samples

__all__ = ["MODELS", "Fit", "Samples", "fit"]
