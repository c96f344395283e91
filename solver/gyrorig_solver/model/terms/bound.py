"""A cause that acts in one recording of several that are fitted together.

What a board or a unit has, it has in all its recordings; a bias that stepped, a board that
slipped did so in one. There a cause is what it is, elsewhere it does nothing.

What to use when: `bound` for a cause of scope `recording` where there are several;
`acts_in` before its bank or its times are asked for; `label` to tell it from the same one
of another recording.
"""

from functools import cache
from typing import Any

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.model.terms.protocol import Term, value_names
from gyrorig_solver.model.terms.scene import Scene


class _Bound:
    """Put before a term's own class: its methods, in its own recording only."""

    recording: int

    def _here(self, scene: Scene) -> bool:
        return scene.setting.number == self.recording

    def effect(self, scene: Scene, values: FloatArray) -> FloatArray:
        plain: Any = super()
        if self._here(scene):
            return np.asarray(plain.effect(scene, values), dtype=np.float64)
        return np.zeros((scene.blocks, 3))

    def change(self, scene: Scene, values: FloatArray) -> FloatArray:
        plain: Any = super()
        if self._here(scene):
            return np.asarray(plain.change(scene, values), dtype=np.float64)
        return np.zeros_like(scene.angle_rad)

    def delay(self, scene: Scene, values: FloatArray) -> FloatArray:
        plain: Any = super()
        if self._here(scene):
            return np.asarray(plain.delay(scene, values), dtype=np.float64)
        return np.zeros(scene.use.size)

    def passed(self, scene: Scene, values: FloatArray) -> Scene:
        plain: Any = super()
        made: Scene = plain.passed(scene, values) if self._here(scene) else scene
        return made

    def columns(self, scene: Scene, values: FloatArray) -> FloatArray:
        plain: Any = super()
        if self._here(scene):
            return np.asarray(plain.columns(scene, values), dtype=np.float64)
        return np.zeros((values.size, scene.blocks, 3))

    def directions(self, scene: Scene, values: FloatArray) -> FloatArray:
        plain: Any = super()
        if self._here(scene):
            return np.asarray(plain.directions(scene, values), dtype=np.float64)
        return np.zeros((len(plain.sizes), scene.blocks, 3))

    def bank(self, scene: Scene) -> FloatArray:
        plain: Any = super()
        rows = np.asarray(plain.bank(scene), dtype=np.float64)
        return rows if self._here(scene) else rows[:0]

    def missing(self, scene: Scene) -> str | None:
        plain: Any = super()
        said: str | None = plain.missing(scene) if self._here(scene) else None
        return said


def bound(term: Term, number: int) -> Term:
    """Return a cause as one of a single recording.

    Args:
        term: of the catalogue.
        number: of the recording, as its setting has it.
    """
    found: Any = object.__new__(_bound_class(type(term)))
    found.__dict__.update(term.__dict__)
    found.recording = number
    made: Term = found
    return made


def recording_of(term: Term) -> int | None:
    """Return the number of the recording that a cause is bound to, None if to none."""
    return term.recording if isinstance(term, _Bound) else None


def acts_in(term: Term, scene: Scene) -> bool:
    """Return whether a cause acts in the recording that a scene is of."""
    return recording_of(term) in (None, scene.setting.number)


def label(term: Term) -> str:
    """Return a cause's name, and after @ its recording, counted from 1, where it has one."""
    number = recording_of(term)
    return term.cause if number is None else f"{term.cause}@{number + 1}"


def labels(term: Term) -> tuple[str, ...]:
    """Return the name of each of a term's values with the cause's before it, shape (k,)."""
    return tuple(f"{label(term)}.{name}" for name in value_names(term))


@cache
def _bound_class(kind: type) -> type:
    return type(f"{kind.__name__}InOneRecording", (_Bound, kind), {})
