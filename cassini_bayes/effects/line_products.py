"""Inner products of a line's columns with what a model leaves: of many lines, and of one.

Of many lines the fit's columns are left in, so that a pass over the rows does; of one they are
taken off.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, partial
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.special import log_ndtr

from cassini_bayes.balance.linearised import InnovationRows, Linear
from cassini_bayes.computing.arrays import Array, Places
from cassini_bayes.computing.cached import cached_property
from cassini_bayes.effects.appendage import KnownMotion, oscillation_series, products_of_turns
from cassini_bayes.effects.line_directions import BODY_AXES
from cassini_bayes.effects.line_shapes import SIZES, Direction, Line, even_mixture
from cassini_bayes.effects.line_starts import LineStarts
from cassini_bayes.effects.oscillation import over_trapezoids


class ManyLines(NamedTuple):
    """What rows show of many lines (f) about every axis, columns as they are.

    ``gram`` (P, f, 3, 3, 3) and ``projection`` (P, f, 3, 3) are of cosine, sine and less the driven
    rate about X, Y and Z, of the rows of each of P free oscillations.
    """

    gram: Array
    projection: Array

    def of_starts(self, count: int) -> ManyLines:
        """With as many free oscillations: those that there are, or one in all events."""
        if count == len(self.gram):
            return self
        return ManyLines(self.gram.sum(0, keepdims=True), self.projection.sum(0, keepdims=True))

    def about_any_direction(self, size: Array) -> Array:
        """Log evidence (f,) about the best direction, roughly; ``size`` (3, 3) about every axis.

        For a given scale S of the swing, with A = S G S + 1 of one free oscillation and b = S Aᵀy,
        w = A^(−1/2) b gains w²/2 and costs log det A / 2; the share has what these leave. Along a
        direction n all w are n·w: of (3, 2 P) of them about the axes the square of the largest
        singular value is the most, and there the share gains nothing.
        """
        each = []
        for scale in SIZES:
            unit = scale * size[:, 0]
            free = unit[:, None, None] ** 2 * self.gram[..., :2, :2] + np.eye(2)
            factor = np.linalg.cholesky(free)
            along = np.stack([self.projection[..., :2], self.gram[..., :2, 2]], axis=-1)
            white = np.linalg.solve(factor, unit[:, None, None] * along)  # (P, f, 3, 2, 2)
            swings, driven = white[..., 0], white[..., 1]
            cost = np.log(np.diagonal(factor, axis1=-2, axis2=-1)).sum((0, -1))
            gain = 0.5 * (swings**2).sum((0, -1)) - cost
            seen = self.gram[..., 2, 2].sum(0) - (driven**2).sum((0, -1))
            shown = self.projection[..., 2].sum(0) - (swings * driven).sum((0, -1))
            flat = np.moveaxis(swings, 0, 2).reshape(*gain.shape, -1)
            largest = np.linalg.eigvalsh(flat @ np.swapaxes(flat, -2, -1))[..., -1]
            oblique = 0.5 * largest - cost.max(axis=-1)
            for share in SIZES:
                precision = (share * size[:, 2]) ** 2 * seen + 1.0
                most = share * size[:, 2] * shown / np.sqrt(precision)
                of_share = 0.5 * most**2 - 0.5 * np.log(precision) + np.log(2.0) + log_ndtr(most)
                each.append(np.maximum((gain + of_share).max(axis=-1), oblique))
        return even_mixture(np.stack(each))


def many_lines(
    rows: Sequence[InnovationRows],
    motions: Sequence[KnownMotion],
    line: tuple[Array, float],
    starts: LineStarts,
) -> ManyLines:
    """Inner products of lines of many frequencies (f,), Hz, and one damping."""
    frequencies, damping = line
    gram = np.zeros((starts.count, len(frequencies), 3, 3, 3))
    projection = np.zeros((starts.count, len(frequencies), 3, 3))
    for event, motion, place in zip(rows, motions, starts.of_rows, strict=True):
        # column a: a unit of momentum about axis a, whitened
        directions: Array = np.asarray(np.linalg.inv(event.noise_factor))
        if event.turns is not None:
            squares, along = products_of_turns(
                event.turns, motion, frequencies, damping, event.white, directions
            )
            gram[place, :, :, :2, :2] += squares
            projection[place, :, :, :2] += np.swapaxes(along, 1, 2)
            continue
        lengths = (directions**2).sum(0)
        left = event.white @ directions
        squares, along = motion.products(event.time_s, frequencies, damping, left)
        squares[:, :2, 2:] *= -1.0  # what the balance lacks is less the driven part
        squares[:, 2:, :2] *= -1.0
        along[:, 2:] *= -1.0
        for axis in range(3):
            places = np.array([0, 1, 2 + axis])
            gram[place, :, axis] += lengths[axis] * squares[:, places[:, None], places]
            projection[place, :, axis] += along[:, places, axis]
    return ManyLines(gram, projection)


@dataclass(frozen=True, eq=False)
class LineProducts:
    """Inner products of one line at a time, less what the fit takes away.

    ``rows`` and ``motions`` are those of every event, ``linear`` the model that left them,
    ``starts`` says which of P free oscillations they have. A line has 2 P + 3 series: their cosines
    and sines, and the driven rate about each axis.
    """

    rows: Sequence[InnovationRows]
    motions: Sequence[KnownMotion]
    linear: Linear
    starts: LineStarts

    @cached_property
    def along_axes(self) -> Callable[[float, float], tuple[Array, Array]]:
        """Gram (3 c, 3 c) and Aᵀy (3 c,) of all series of a frequency (Hz) and damping."""

        @cache
        def found(frequency_hz: float, damping: float) -> tuple[Array, Array]:
            every = np.eye(2 * self.starts.count + 3)
            return self._of(BODY_AXES, (frequency_hz, damping), every)

        return found

    def about(self, line: Line, columns: Array) -> tuple[Array, Array]:
        """Gram (q, q) and Aᵀy (q,) of a line, ``columns`` (2 P + 3, q) of its series."""
        return self._of((line[2],), line[:2], columns)

    @cached_property
    def _factor(self) -> tuple[Array, bool]:
        factor: tuple[Array, bool] = cho_factor(self.linear.gram())
        return factor

    @cached_property
    def _views(self) -> Callable[[Direction], list[_View]]:
        return cache(partial(_views, self.rows, self.linear))

    def _of(
        self, directions: Sequence[Direction], shape: tuple[float, float], columns: Array
    ) -> tuple[Array, Array]:
        """Gram (b q, b q) and Aᵀy (b q,) along b directions."""
        count, width = len(directions), columns.shape[1]
        gram, projection = np.zeros((count, count, width, width)), np.zeros((count, width))
        across = np.zeros((count, len(self._factor[0]), width))
        views = [self._views(direction) for direction in directions]
        for event, motion, place, *own in zip(
            self.rows, self.motions, self.starts.of_rows, *views, strict=True
        ):
            series = np.column_stack(oscillation_series(event.time_s, motion, *shape))
            made = columns[self.starts.series(place)]
            # most columns have nothing of an event whose start is its own
            has = np.flatnonzero(made.any(axis=0))
            shown = _shown(event, motion, series @ made[:, has], shape[0])
            each = _squares(own, shown)
            for a, view in enumerate(own):
                projection[a, has] += view.white @ shown
                across[a][np.ix_(view.places, has)] += view.columns.T @ shown
                for b in range(count):
                    gram[a, b][np.ix_(has, has)] += each[a, b]
        flat = np.concatenate([*across], axis=1)
        whole = np.swapaxes(gram, 1, 2).reshape(flat.shape[1], -1)
        return whole - flat.T @ cho_solve(self._factor, flat), projection.ravel()


def _shown(event: InnovationRows, motion: KnownMotion, series: Array, frequency_hz: float) -> Array:
    """Series (n, c) as an event shows them: of turns integrated, along the modes of pieces."""
    if event.turns is None:
        return series
    seen = over_trapezoids(frequency_hz, motion.step_s)
    return event.turns.in_modes(seen * event.turns.pieces.integrated(series))


class _View(NamedTuple):
    """What one event's rows show along a direction: inner products with series are those of these.

    ``unit`` (3,) is a whitened unit, ``white`` (n,) and ``columns`` (n, k) innovations and those of
    the linear model's columns that the event has along it, at ``places`` (k,). Of turns all are
    along the modes of their pieces, times ``weights`` (n, 3), which make noise about the whitened
    axes white.
    """

    unit: Array
    white: Array
    columns: Array
    places: Places
    weights: Array | None


def _squares(views: Sequence[_View], shown: Array) -> Array:
    """Inner products (b, b, q, q) of series (n, q) about b directions of one event."""
    units = np.stack([view.unit for view in views])
    weights = views[0].weights
    if weights is None:
        return np.asarray((units @ units.T)[:, :, None, None] * (shown.T @ shown))
    of_axes = np.stack([(shown * own[:, None]).T @ (shown * own[:, None]) for own in weights.T])
    return np.asarray(np.einsum("ai,bi,iqr->abqr", units, units, of_axes))


def _views(rows: Sequence[InnovationRows], linear: Linear, direction: Direction) -> list[_View]:
    """Every event's view of a direction."""
    views = []
    for event, part in zip(rows, linear.columns.parts, strict=True):
        unit: Array = np.asarray(np.linalg.solve(event.noise_factor, np.array(direction)))
        values = part.values.reshape(len(event.white), 3, -1)
        if event.turns is None:
            along = np.tensordot(values, unit, (1, 0))
            views.append(_View(unit, event.white @ unit, along, part.places, None))
            continue
        weights = np.stack([event.turns.weights(axis) for axis in range(3)], axis=1)
        seen = np.zeros((len(weights), 1 + values.shape[2]))
        for axis in range(3):
            own = np.column_stack([event.white[:, axis], values[:, axis]])
            seen += (unit[axis] * weights[:, axis])[:, None] * event.turns.in_modes(own)
        views.append(_View(unit, seen[:, 0], seen[:, 1:], part.places, weights))
    return views
