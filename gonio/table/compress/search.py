"""The coarsest step of quantisation that holds the bounds on the error of all rows."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from gonio.table.compress.frame import Frame
from microgeometry.errors import InputError

Array = NDArray[np.float64]

_TRIALS = 8
_BEYOND = 1.1 ** np.arange(7, 0, -1)
"""Where larger steps are tried than the first found to hold: errors of few coefficients jump about."""
_MOST = 0.8  # share of rows and channels that one step is to suit
_NEEDED = 0.6  # of the error allowed: rows that come so near to it need their step
_ROUNDS = 12

Prepare = Callable[[Frame], Callable[[float], Array]]
Excess = Callable[[Array], Array]


def hold(frame: Frame, excess: Excess, prepare: Prepare, quick: bool = False) -> float:
    """Find the coarsest step whose approximation holds the bounds of all rows.

    Parameters
    ----------
    frame : Frame
    excess : callable
        From values to their error in each row and channel over what is allowed, shape (I, C).
    prepare : callable
        From a frame to a function from a step to the values that the decoder will correct.
    quick : bool
        Look for the step to 20 % only, enough to compare methods by.

    Returns
    -------
    float

    Raises
    ------
    InputError
        No step holds the bounds.
    """
    decoded = prepare(frame)

    def worst(step: float) -> float:
        return float(excess(frame.correct(decoded(step))).max())

    if quick:
        return _largest(worst, 0.1, 1.2)
    step = _largest(worst, 0.1, 1.02)
    return next((further for further in step * _BEYOND if worst(further) <= 1.0), step)


def suit_most(frame: Frame, excess: Excess, prepare: Prepare, step: float) -> tuple[Frame, float] | None:
    """A step that suits most rows, and the frame in which it holds the bounds of the others too.

    Few rows would have all others stored too finely; here they alone are. From what `hold` was given and what it
    returned; None where most need that step anyway, or a few rounds do not find another.
    """
    decoded = prepare(frame)

    def most(step: float) -> float:
        return float(np.quantile(excess(frame.correct(decoded(step))), _MOST))

    if most(step) > _NEEDED:
        return None
    suited = _largest(most, step, 1.1)
    for _ in range(_ROUNDS):
        errors = excess(frame.correct(prepare(frame)(suited)))
        if errors.max() <= 1.0:
            return frame, suited
        frame = frame.finer(errors)
    return None


def _largest(worst: Callable[[float], float], step: float, tolerance: float) -> float:
    """The largest step found, to a factor, at which `worst`, an error over its bound, is at most 1.

    The error grows smoothly with the step, roughly as its power: a secant on logarithms, kept in brackets.
    """
    low, high, failures = 0.0, np.inf, 0
    for trial in range(40):
        error = worst(step)
        if error <= 1.0:
            low, failures = step, 0
        else:
            high, failures = step, failures + 1
        if low > 0 and (high / low < tolerance or trial >= _TRIALS):
            return low
        guess = step * (0.98 / max(error, 1e-3)) ** 0.8
        if not low < guess < high or (failures >= 2 and low > 0):
            # against noise the error hardly depends on the step: then halve the bracket
            if low > 0:
                guess = np.sqrt(low * high) if np.isfinite(high) else 2 * low
            else:
                guess = high / 4
        step = float(guess)
    raise InputError("max_error: no step of quantisation holds it")
