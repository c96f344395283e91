"""Recordings of an emulated rig that hides something; truth and finder share no code."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from tests.support.emulated_recordings import record_once
from tests.support.made_once import shared_folder

from gyrorig_protocol.recording.reader import read_recording
from gyrorig_protocol.recording.recording import Recording

ROOT = Path(__file__).resolve().parents[3]
CONFIG = ROOT / "config" / "rig.yaml"


@dataclass(frozen=True)
class HiddenRecording:
    """A recording, and what it hides."""

    recording: Recording
    truth: list[dict[str, Any]]
    boards: dict[str, Any]  # true parameters by board

    @property
    def board(self) -> str:
        """The first board."""
        return str(self.recording.board_ids[0])


@pytest.fixture(scope="module")
def hidden(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., HiddenRecording]:
    """Return a function that records a session with something hidden in it, once each.

    The test files share the recordings: many of them use the same ones.
    """
    shared = shared_folder(tmp_path_factory)
    made: dict[tuple[str, ...], HiddenRecording] = {}

    def record(
        *hide: str, seed: int = 7, program: str = "quick", config: Path = CONFIG
    ) -> HiddenRecording:
        key = (*hide, str(seed), program, str(config))
        if key not in made:
            causes = [word for text in hide for word in ("--hide", text)]
            session = record_once(shared, program, "--seed", str(seed), *causes, config=config)
            truth = session.truth
            hidden_causes = truth.get("hidden") or {"causes": []}
            recording = read_recording(session.path)
            made[key] = HiddenRecording(recording, hidden_causes["causes"], truth["boards"])
        return made[key]

    return record


@pytest.fixture
def pair(hidden: Callable[..., HiddenRecording]) -> tuple[HiddenRecording, HiddenRecording]:
    """Return a survey and a rest of one board."""
    return hidden(program="survey-40"), hidden(program="static")
