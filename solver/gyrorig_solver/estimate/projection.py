"""What a fit cannot take of a signal: the space in which causes are looked for.

All signals of a board's recordings are put one after the other and whitened; what gain,
biases, time offsets, the references' own unknowns and the fitted causes can follow is
taken out, each as far as what is known of it lets it. A signal's energy there is what it
adds to the evidence; its product with the residual is its score.

What to use when: `Projection.of` at a fit; `white` for signals, `look` for what they say.

Source: score (Lagrange multiplier) test with nuisances eliminated; Rao, Linear Statistical
Inference, 6e.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from scipy.fft import dct, idct
from scipy.sparse import csc_array, csr_array

from gyrorig_solver.arrays import FloatArray, IntArray
from gyrorig_solver.arrow import factor
from gyrorig_solver.estimate.chain import CUTTING, Chain, lost_without, shown_of
from gyrorig_solver.estimate.extension import Extension
from gyrorig_solver.estimate.followed import Prior, base_of
from gyrorig_solver.estimate.likelihood import Solution
from gyrorig_solver.estimate.noise import NoiseModel
from gyrorig_solver.estimate.products import product, sparse_product
from gyrorig_solver.estimate.stretch import Stretch
from gyrorig_solver.estimate.whitening import PartModel
from gyrorig_solver.model.terms.bound import label
from gyrorig_solver.model.terms.protocol import Term
from gyrorig_solver.model.terms.scene import Scene

ONCE = 0.01  # share of a cause's information below which data do not tell of it

Signal = Callable[[Scene], FloatArray]  # to (k, blocks, 3)


@dataclass(frozen=True, slots=True, eq=False)
class Looked:
    """What signals say beside a fit."""

    information: FloatArray  # (k, k), what of them the fit cannot take
    score: FloatArray  # (k,), against the residual
    raw: FloatArray  # (k,), energy before the fit took its share
    taken: FloatArray  # (k, q), what a unit of each makes of the board's parameters

    def part(self, at: Sequence[int] | IntArray) -> "Looked":
        """Return what some of them say."""
        some = np.asarray(at)
        if some.size == 1:
            one = slice(int(some[0]), int(some[0]) + 1)
            return Looked(
                self.information[one, one], self.score[one], self.raw[one], self.taken[one]
            )
        return Looked(
            self.information[np.ix_(some, some)],
            self.score[some],
            self.raw[some],
            self.taken[some],
        )


@dataclass(frozen=True, slots=True, eq=False)
class Lacking:
    """A fit's model less some of its causes."""

    rows: IntArray  # which of the unknowns that are not local remain
    residual: FloatArray  # (all,), whitened, with the effect of what is gone


class Projection:
    """The space beside a fit; see the module."""

    def __init__(
        self,
        stretches: Sequence[Stretch],
        extensions: Sequence[Extension],
        base: FloatArray,
        local: csr_array,
        prior: Prior,
        at_work: Sequence[Extension] = (),
    ) -> None:
        """Take what `of` has put together; causes `at_work` are in what the residual is of."""
        self.stretches, self.extensions = tuple(stretches), tuple(extensions)
        self.residual = self.white([[r[None] for r in s.residuals] for s in stretches])[0]
        self._base, self._local, self._prior = base, local, prior
        near = (local @ local.T + prior.local).tocsc()
        self._near = factor(csc_array(near))
        self._cross = local @ base.T + prior.cross
        self._carry = self._near(self._cross)
        shared = base @ base.T + prior.shared
        inner = shared - self._cross.T @ self._carry
        self._inverse = np.linalg.pinv(inner, hermitian=True)
        # What a cause did once, in data left out, the rest cannot tell: it stays as it was.
        self._once = np.zeros(base.shape[0])
        self._once[prior.first : prior.board] = ONCE * np.diag(inner)[prior.first : prior.board]
        self._pull_local = local @ self.residual + prior.pull_local
        self._pull = base @ self.residual + prior.pull_shared
        self.board = prior.board
        self._chains = [[Chain(at_work, one) for one in s.scenes] for s in stretches]
        self._exact = [[Chain(at_work, one) for one in s.exact] for s in stretches]
        self._looked_at = ""

    @classmethod
    def of(
        cls,
        solution: Solution,
        extensions: Sequence[Extension] | None = None,
        back: Sequence[Extension] = (),
        noises: Sequence[NoiseModel] | None = None,
    ) -> Self:
        """Return the space beside a fit.

        Args:
            solution: the fit; its sessions hold their state.
            extensions: causes that may follow; those of the fit by default.
            back: causes of the fit whose effect is given back to the residual.
            noises: of each recording, those of the fit by default.
        """
        follow = solution.extensions if extensions is None else tuple(extensions)
        stay = [one for one in solution.extensions if all(one is not other for other in back)]
        stretches = []
        for number, session in enumerate(solution.sessions):
            noise = (noises or solution.noises)[number]
            left = session.residuals(solution.gain)
            series: dict[int, list[tuple[PartModel, Scene, Scene, FloatArray]]] = {}
            for k, blocks, as_fitted, scene, exact in session.derivatives(solution.gain):
                residual, model = left[k][blocks].copy(), as_fitted
                if back:
                    given = lost_without(back, solution.extensions, exact)
                    residual += np.where(model.used[:, None], given, 0.0)
                if any(one.term.link in CUTTING for one in back):
                    model = replace(as_fitted, shown=shown_of(stay, exact))
                series.setdefault(k, []).append((model, scene, exact, residual))
            for parts in series.values():
                models, scenes, fine, residuals = zip(*parts, strict=True)
                used = tuple(m.used for m in models)
                stretches.append(Stretch(number, used, scenes, fine, models, residuals, noise))
        base, local, prior = base_of(solution, stretches, follow)
        return cls(stretches, follow, base, local, prior, stay)

    def without(self, gone: Sequence[int]) -> "Lacking":
        """Return the fit's model less some of its causes: their effect goes back.

        Args:
            gone: numbers of causes among those that this space was made with.
        """
        rows = np.ones(self._base.shape[0], dtype=np.bool_)
        at = self._prior.first
        for k, one in enumerate(self.extensions):
            rows[at : at + one.free.size] = k not in gone
            at += one.free.size
        if not gone:
            return Lacking(np.flatnonzero(rows), self.residual)
        lost = [one for k, one in enumerate(self.extensions) if k in gone]

        def back(scene: Scene) -> FloatArray:
            return lost_without(lost, self.extensions, scene)[None]

        return Lacking(np.flatnonzero(rows), self.residual + self.signals(back, exact=True)[0])

    def kept_out(self, windows: IntArray, models: Sequence["Lacking"]) -> FloatArray:
        """Return each model's whitened residual of data that it did not see, (models, all).

        Each window in turn is left out, everything is fitted to the others, and in the
        window only the motion's local unknowns follow: they are no part of what is judged.

        Args:
            windows: to which window each whitened value belongs, shape (all,).
            models: from `without`.
        """
        out = np.zeros((len(models), self.residual.size))
        for window in np.unique(windows):
            held = np.flatnonzero(windows == window)
            rest = np.flatnonzero(windows != window)
            own = self._fitted_to(rest, models)
            base, local = self._base[:, held], self._local[:, held]
            near = factor(csc_array((local @ local.T + self._prior.local).tocsc()))
            left = np.stack([one.residual[held] for one in models]) - own.T @ base
            pull = local @ left.T + self._prior.pull_local[:, None] - self._prior.cross @ own
            out[:, held] = left - (local.T @ near(pull)).T
        return out

    def _fitted_to(self, some: IntArray, models: Sequence["Lacking"]) -> FloatArray:
        """Return the step of all but local unknowns that fits a part best, (q, models)."""
        base, local = self._base[:, some], self._local[:, some]
        near = factor(csc_array((local @ local.T + self._prior.local).tocsc()))
        cross = local @ base.T + self._prior.cross
        carry = near(cross)
        inner = base @ base.T + self._prior.shared - cross.T @ carry + np.diag(self._once)
        found = np.zeros((base.shape[0], len(models)))
        for k, one in enumerate(models):
            residual = one.residual[some]
            pull = local @ residual + self._prior.pull_local
            score = base @ residual + self._prior.pull_shared - carry.T @ pull
            inverse = np.linalg.pinv(inner[np.ix_(one.rows, one.rows)], hermitian=True)
            found[one.rows, k] = inverse @ score[one.rows]
        return found

    def unwhitened(self, white: FloatArray) -> list[FloatArray]:
        """Return a whitened signal (all,) as rates, (n, 3) a part; 0 where unused."""
        found, start = [], 0
        for s in self.stretches:
            for used in s.used:
                n = used.size
                deviation = np.sqrt(s.noise.variance(n)).T
                spectrum = dct(white[start : start + 3 * n].reshape(3, n), axis=-1, norm="ortho")
                rate = idct(spectrum * deviation, axis=-1, norm="ortho").T
                found.append(np.where(used[:, None], rate, 0.0))
                start += 3 * n
        return found

    @property
    def scenes(self) -> list[Scene]:
        """What causes look at, part by part."""
        return [scene for s in self.stretches for scene in s.scenes]

    def weighed(self) -> list[FloatArray]:
        """Return the residual weighed by the noise's inverse covariance, (n, 3) a part.

        Its product with an unwhitened signal is the signal's score.
        """
        found, start = [], 0
        for s in self.stretches:
            for used in s.used:
                n = used.size
                white = self.residual[start : start + 3 * n].reshape(3, n)
                deviation = np.sqrt(s.noise.variance(n)).T
                spectrum = dct(white, axis=-1, norm="ortho") / deviation
                signal = idct(spectrum, axis=-1, norm="ortho").T
                found.append(np.where(used[:, None], signal, 0.0))
                start += 3 * n
        return found

    def white(self, signals: Sequence[Sequence[FloatArray]]) -> FloatArray:
        """Return signals (k, n, 3) of each part of each series, whitened, (k, all)."""
        found = [s.whitened(p) for s, p in zip(self.stretches, signals, strict=True)]
        return found[0] if len(found) == 1 else np.concatenate(found, axis=1)

    def signals(self, of: Signal, exact: bool = False, term: Term | None = None) -> FloatArray:
        """Return what a function of each scene gives, (k, blocks, 3), whitened, (k, all).

        Args:
            of: the function.
            exact: of the scenes on the samples' own grid.
            term: of the scenes as this cause finds them, those of the fit before it at work;
                None: of the scenes as the unit believes them.
        """
        if term is None:
            return self.white(
                [[of(one) for one in (s.exact if exact else s.scenes)] for s in self.stretches]
            )
        return self.white(
            [
                [one.cut(term, of(one.at(term))) for one in part]
                for part in self._composed(term, exact)
            ]
        )

    def fitted(self, term: Term, values: FloatArray, free: IntArray | Sequence[int]) -> FloatArray:
        """Return a cause's derivatives and last its effect beside the fit, whitened, exact.

        Args:
            term: the cause.
            values: of all its parameters, (k,).
            free: by which of them to derive.
        """
        found = []
        for part in self._composed(term, exact=True):
            signals = []
            for one in part:
                columns = one.cut(term, term.columns(one.at(term), values)[free])
                signals.append(np.concatenate([columns, one.effect(term, values)[None]]))
            found.append(signals)
        return self.white(found)

    def _composed(self, term: Term, exact: bool) -> list[list[Chain]]:
        """Return the chains of each part; of exact ones only one cause's scenes are kept."""
        if exact and self._looked_at != label(term):
            for one in (one for part in self._exact for one in part):
                one.forget()
            self._looked_at = label(term)
        return self._exact if exact else self._chains

    def look(self, white: FloatArray) -> Looked:
        """Return what whitened signals say beside the fit."""
        felt, own = sparse_product(self._local, white), product(self._base, white)
        shared = self._inverse @ (own - self._carry.T @ felt)
        near = self._near(felt) - self._carry @ shared
        gram = product(white, white)
        return Looked(
            gram - felt.T @ near - own.T @ shared,
            white @ self.residual - near.T @ self._pull_local - shared.T @ self._pull,
            np.diag(gram).copy(),
            shared[: self.board].T,
        )

    def apart(self) -> "Apart":
        """Return what the space is made of."""
        board, prior = self.board, self._prior
        across = prior.cross[:, board:]
        return Apart(
            own=self._base[:board],
            own_known=prior.shared[:board, :board],
            own_pull=prior.pull_shared[:board],
            local=self._local,
            shared=self._base[board:],
            motion_known=np.block(
                [[prior.local.toarray(), across], [across.T, prior.shared[board:, board:]]]
            ),
            motion_away=prior.away,
        )

    def left(self, white: FloatArray) -> FloatArray:
        """Return what remains of one whitened signal once the fit has followed, (all,)."""
        felt, own = self._local @ white, self._base @ white
        shared = self._inverse @ (own - self._carry.T @ felt)
        near = self._near(felt) - self._carry @ shared
        return np.asarray(white - self._local.T @ near - self._base.T @ shared, np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class Apart:
    """What a space is made of: derivatives, whitened, and what is known of the unknowns."""

    own: FloatArray  # (board, all), by the board's own: G, each (b, tau), causes
    own_known: FloatArray  # (board, board), information
    own_pull: FloatArray  # (board,), score of that
    local: csr_array  # (m, all), by the motion's local unknowns
    shared: FloatArray  # (g, all), by its shared ones
    motion_known: FloatArray  # (m + g, m + g), information
    motion_away: FloatArray  # (m + g,), where that has them, minus where they are
