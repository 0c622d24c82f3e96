"""Angular velocity as data: how the direction of the field that the sensors agree on turns from sample to sample.

The direction u of a field that is uniform and constant in direction in the world is turned back in the array frame by
what the array is turned by: u' = exp(-X S φ) u. Nothing else of the path matters, as the turn about the field does not
show. With T two unit vectors across u, F = T'ᵀ exp(-X S φ) T, V the covariance of u across itself, and q that of the
angular velocity's integral, the two numbers of each interval

    ε = T'ᵀ exp(-X S φ) u,    cov(ε, ε) = q + F V Fᵀ + V',    cov(ε', ε) = -F' V',

are all that the path tells of the errors of the sensors: their covariance has two blocks off its diagonal, and a
banded Cholesky factor makes them white at a cost that grows as the number of samples does. The unknown path is
eliminated with it. Field and turn in the derivatives are the smoothed ones, u + T V (λ' - Fᵀ λ) with T across it, and
the turn less q Tᵀ λ, with λ the residuals over their covariance: they do not depend on the noise of the residuals,
which would pull the errors of sensors and gyroscope towards zero.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.linalg import inv, norm

from tam_calibration.core.least_squares import Normal, gram
from tam_calibration.fit.ellipsoid import COLUMNS, ROWS, Normalized
from tam_calibration.fit.gyroscope_path import GyroscopePath, GyroscopeState, GyroscopeUse
from tam_calibration.fit.likelihood import ChannelMaps
from tam_calibration.fit.recorded_attitude import across_of
from tam_calibration.model.array import KnownNoiseArray
from tam_calibration.model.limits import RATE_NOISE
from tam_calibration.model.mounting import rotation_matrix
from tam_calibration.model.units import FloatArray


class _Chain(NamedTuple):
    """The intervals at a point: directions across the field, its turns, and what they are whitened by."""

    field: FloatArray
    length: FloatArray
    across: FloatArray
    through: FloatArray
    residual: FloatArray
    variance: FloatArray
    band: FloatArray
    turned: FloatArray


@dataclass(frozen=True, eq=False)
class WhiteTurns:
    """Turns of the field against those of the gyroscope at a point, of unit variance where all is as it should be.

    Parameters
    ----------
    columns : (P + 1, 2 L) array
        Derivatives by the unknowns of the fit, and the residuals last.
    factor : (4, 2 L) array
        Banded Cholesky factor of the covariance of the two numbers of each interval.
    by_offset : (3, N, 2) array
        Derivatives of the direction across itself by a field along each axis of the array, of every sample.
    through : (L, 2, 2) array
        What an interval makes of a direction before it.
    links : (L,) array
        Number of the sample before each interval.
    """

    columns: FloatArray
    factor: FloatArray
    by_offset: FloatArray
    through: FloatArray
    links: np.ndarray

    def by_courses(self, courses: FloatArray) -> FloatArray:
        """Return what fields along x, y and z do that go with time as courses (M, N) say: (M, 3, 2 L)."""
        moved = courses[:, None, :, None] * self.by_offset
        change = moved[:, :, self.links + 1] - np.einsum("nab,mpnb->mpna", self.through, moved[:, :, self.links])
        return _whitened(self.factor, change.reshape(-1, len(self.links), 2)).reshape(len(courses), 3, -1)

    def scores(self, residual: FloatArray) -> FloatArray:
        """Return the inner products (N, 3) of residuals (2 L,) with what a field in one sample along each axis does."""
        from scipy.linalg.lapack import dtbtrs

        pull = dtbtrs(self.factor, residual[:, None], uplo="L", trans="T")[0].reshape(-1, 2)
        scores = np.zeros(self.by_offset.shape[1::-1])
        scores[self.links] -= np.einsum("pnb,nab,na->np", self.by_offset[:, self.links], self.through, pull)
        scores[self.links + 1] += np.einsum("pna,na->np", self.by_offset[:, self.links + 1], pull)
        return scores


@dataclass(frozen=True, eq=False)
class GyroscopeLikelihood:
    """Samples whose angular velocity is known.

    Parameters
    ----------
    rows : (3 K, n) array
        Readings about an origin, in units of a field, of every sample of the path's stride.
    path : GyroscopePath
        The angular velocities.
    vector_noise : (K,) array
        Standard deviation of each sensor's axes, in the same unit.
    use : GyroscopeUse
        How they count. The integral of the noise over Δt has the variance density² Δt / 2.
    """

    rows: FloatArray
    path: GyroscopePath
    vector_noise: FloatArray
    use: GyroscopeUse

    @classmethod
    def of(cls, data: Normalized, array: KnownNoiseArray, use: GyroscopeUse) -> "GyroscopeLikelihood | None":
        """Return the samples as data of the turn between them; None where they have no angular velocity."""
        recording = data.source.whole()
        rates = recording.angular_velocity_rad_s
        if rates is None:
            return None
        path = GyroscopePath(
            recording.time_s, rates, use.interval_s, recording.time_span_s, use.start.delay_s, use.stride
        )
        if not len(path.links):
            return None
        rows = data.points.reshape(recording.sample_count, -1).T[:, :: path.stride]
        return cls(rows, path, array.vector_noise_T / data.radius_T, use)

    @property
    def sample_count(self) -> int:
        """Number of samples."""
        return len(self.path.time_s)

    def start(self, matrix: FloatArray, bias: FloatArray) -> GyroscopeState:
        """Return the state at which a fit begins, whatever the errors of the sensors."""
        return self.use.start.of_modes(self.path.modes)

    def prior(self, state: GyroscopeState, main_field_T: FloatArray | None) -> tuple[FloatArray, FloatArray]:
        """Return the precisions (Q,) of the unknowns of a state before a fit, and the downhill gradient (Q,).

        A shape that is not fitted has none. A field of the world tells nothing of a gyroscope.
        """
        modes = np.maximum(np.arange(len(state.bias)), 1)
        shape = 1 / self.use.shape_error**2 if self.use.shape_error else 0.0
        of_bias = np.repeat((modes / self.use.bias_error) ** 2, 3)
        # np.pi and 1.0: standard deviations of a mounting and a delay of which nothing is known, radians and seconds:
        # they keep the normal equations regular.
        precision = np.concatenate([of_bias, [1.0**-2], np.full(3, np.pi**-2), np.full(6, shape)])
        away = np.concatenate([state.bias.ravel(), np.zeros(4), (state.shape - np.eye(3))[ROWS, COLUMNS]])
        return precision, -precision * away

    def part(self, samples: slice) -> "GyroscopeLikelihood":
        """Return the likelihood of some of the samples, from a whole stride on."""
        stride = self.path.stride
        first = -(-(samples.start or 0) // stride)
        last = self.rows.shape[1] if samples.stop is None else -(-samples.stop // stride)
        path = self.path.part(slice(first * stride, samples.stop))
        return replace(self, rows=self.rows[:, first:last], path=path)

    def coarser(self, times: int) -> "GyroscopeLikelihood":
        """Return the likelihood of turns over so many times as many samples."""
        path = replace(self.path, stride=times * self.path.stride)
        return replace(self, rows=self.rows[:, ::times], path=path)

    def linearize(self, matrix: FloatArray, bias: FloatArray, state: GyroscopeState) -> Normal:
        """Return the normal equations at a point.

        Parameters
        ----------
        matrix : (K, 3, 3) array
            D Λ of each sensor.
        bias : (K, 3) array
            Of each sensor, in the unit of the readings.
        state : GyroscopeState
            Of the gyroscope.
        """
        channels = ChannelMaps.at(matrix, bias, self.vector_noise)
        if not len(self.path.links):
            size = 13 + state.size
            return Normal.by_field(channels.response, np.zeros((size, size)), 0)
        white = self._white_turns(channels, state).columns
        found = Normal.by_field(channels.response, gram(white) / self.use.lasting, white.shape[1])
        return replace(found, energy=self.use.lasting * found.energy)

    def white_turns(self, matrix: FloatArray, bias: FloatArray, state: GyroscopeState) -> WhiteTurns:
        """Return the turns of the field at a point; parameters as of ``linearize``."""
        return self._white_turns(ChannelMaps.at(matrix, bias, self.vector_noise), state)

    def _white_turns(self, channels: ChannelMaps, state: GyroscopeState) -> WhiteTurns:
        chain = self._chain(channels, state)
        factor = self._factor(chain, self.use.density)
        columns = _whitened(factor, self._columns(chain, factor, state))
        by_offset = np.moveaxis(chain.across, 2, 0) / chain.length[:, None]
        return WhiteTurns(columns, factor, by_offset, chain.through, self.path.links)

    def scatter(
        self, matrix: FloatArray, bias: FloatArray, state: GyroscopeState, taken: float = 0.0, sigmas: float = 0.0
    ) -> float:
        """Return the density with which the residuals are as large as they are, rad/s/√Hz; 0 where they are smaller.

        Parameters
        ----------
        matrix, bias, state
            As of ``linearize``.
        taken : float
            Number of channels that the fit has taken.
        sigmas : float
            Standard deviations of chance by which the residuals may be smaller than by that density.
        """
        chain = self._chain(ChannelMaps.at(matrix, bias, self.vector_noise), state)
        freedom = max(chain.residual.size - taken, 1.0)
        wanted = freedom - sigmas * np.sqrt(2 * freedom)

        def excess(exponent: float) -> float:
            white = _whitened(self._factor(chain, 10**exponent), chain.residual[None].copy())
            return float(np.sum(white**2) - wanted)

        low, high = (float(np.log10(each)) for each in (RATE_NOISE.least, RATE_NOISE.most))
        if excess(low) <= 0:
            return 0.0
        # Of the exponent of a density: nine decades to a thousandth.
        for _ in range(14):
            middle = (low + high) / 2
            low, high = (middle, high) if excess(middle) > 0 else (low, middle)
        return float(10**high)

    def _chain(self, channels: ChannelMaps, state: GyroscopeState) -> _Chain:
        field = (channels.field[:, :-1] @ self.rows + channels.field[:, -1:]).T
        length = norm(field, axis=1)
        along = field / length[:, None]
        across = across_of(along)
        links = self.path.links
        turned = self.path.turns(state) @ (state.mount @ state.shape).T
        # The transposed rotation turns back.
        moved = np.concatenate([along[links, None], across[links]], axis=1) @ rotation_matrix(turned)
        residual = np.einsum("nai,ni->na", across[links + 1], moved[:, 0])
        through = np.einsum("nai,nbi->nab", across[links + 1], moved[:, 1:])
        covariance = channels.elimination.covariance
        variance = np.einsum("nai,ij,nbj->nab", across, covariance, across, optimize=True) / length[:, None, None] ** 2
        rate = np.zeros((len(along), 2))
        rate[links + 1] = np.einsum("nai,ni->na", across[links + 1], along[links]) / self.path.duration_s[:, None]
        variance += self.use.jitter_s**2 * rate[:, :, None] * rate[:, None, :]
        own = through @ variance[links] @ np.swapaxes(through, 1, 2) + variance[links + 1]
        between = -(through[1:] @ variance[links[1:]]) * self.path.follows[:, None, None]
        # What the sensors' noise makes of the channels' covariance: diagonal, then the three below it of blocks of two.
        band = np.zeros((4, len(links), 2))
        band[0] = own[:, (0, 1), (0, 1)]
        band[1, :, 0], band[1, :-1, 1] = own[:, 1, 0], between[:, 0, 1]
        band[2, :-1, 0], band[2, :-1, 1] = between[:, 0, 0], between[:, 1, 1]
        band[3, :-1, 0] = between[:, 1, 0]
        return _Chain(field, length, across, through, residual, variance, band.reshape(4, -1), turned)

    def _factor(self, chain: _Chain, density: float) -> FloatArray:
        """Return the banded Cholesky factor of the channels' covariance, with the noise of the gyroscope."""
        from scipy.linalg import cholesky_banded

        band = chain.band.copy()
        band[0] += np.repeat(density**2 * self.path.duration_s / 2, 2)
        return np.asarray(cholesky_banded(band, lower=True, overwrite_ab=True))

    def _columns(self, chain: _Chain, factor: FloatArray, state: GyroscopeState) -> FloatArray:
        """Return (12 + Q + 1, L, 2): across ⊗ [field, 1] / |field|, by the gyroscope, residual."""
        from scipy.linalg import cho_solve_banded

        links = self.path.links
        columns = np.empty((13 + state.size, len(links), 2))
        pull = cho_solve_banded((factor, True), chain.residual.ravel()).reshape(-1, 2)
        along, across = self._smoothed(chain, pull)
        extended = np.concatenate([along.T, 1 / chain.length[None]])
        sides = np.moveaxis(across, 2, 0).copy()
        by_field = (sides[:, None] * extended[None, :, :, None]).reshape(12, -1, 2)
        columns[:12] = by_field[:, links + 1] - np.einsum("nab,pnb->pna", chain.through, by_field[:, links])
        first, second = np.moveaxis(across[links + 1], 1, 0)
        # Across is right-handed: a turn δ moves the predicted direction u by -δ × u, which along T is -δ · (u × T).
        by_turn = np.stack([-second, first], axis=1)
        by_angle = np.moveaxis(by_turn @ (state.mount @ state.shape), 2, 0).copy()
        by_bias = -by_angle * self.path.duration_s[:, None]
        place = 12 + state.bias.size
        for course, into in zip(self.path.courses, columns[12:place].reshape(-1, 3, len(links), 2), strict=True):
            np.multiply(by_bias, course[:, None], out=into)
        columns[place] = np.einsum("ina,ni->na", by_angle, self.path.by_delay)
        noise = np.einsum("nai,na->ni", by_turn, pull) * (self.use.density**2 * self.path.duration_s / 2)[:, None]
        turned = chain.turned - noise
        columns[place + 1 : place + 4] = np.moveaxis(np.cross(turned[:, None], by_turn), 2, 0)
        by_shape, angle = by_turn @ state.mount, (turned @ inv(state.mount @ state.shape).T)[:, None]
        for into, row, column in zip(columns[place + 4 : -1], ROWS, COLUMNS, strict=True):
            np.multiply(by_shape[:, :, row], angle[:, :, column], out=into)
            if row != column:
                into += by_shape[:, :, column] * angle[:, :, row]
        columns[-1] = chain.residual
        return columns

    def _smoothed(self, chain: _Chain, pull: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the smoothed directions u (N, 3) of the field, and T (N, 2, 3) across them."""
        shift = np.zeros((len(chain.field), 2))
        shift[self.path.links] -= np.einsum("nba,nb->na", chain.through, pull)
        shift[self.path.links + 1] += pull
        shift = np.einsum("nab,nb->na", chain.variance, shift)
        along = chain.field / chain.length[:, None]
        moved = along + np.einsum("na,nai->ni", shift, chain.across)
        return moved, chain.across - shift[:, :, None] * along[:, None]


def _whitened(factor: FloatArray, columns: FloatArray) -> FloatArray:
    """Return columns (P, L, 2) as (P, 2 L) of unit variance; they are used up."""
    from scipy.linalg.lapack import dtbtrs

    white, _ = dtbtrs(factor, columns.reshape(len(columns), -1).T, uplo="L", overwrite_b=1)
    return np.asarray(white.T)
