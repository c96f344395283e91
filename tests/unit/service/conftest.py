"""A service on an emulated rig, in simulated time and with a system time of its own."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from tests.support.simulated_service import Bench, board_with

from gyrorig_daemon.emulator.emulator_settings import RigSettings


@pytest.fixture
def faulty_board() -> Callable[..., Callable[[RigSettings], RigSettings]]:
    return board_with


@pytest.fixture
def make_bench(tmp_path: Path) -> Iterator[Callable[..., Bench]]:
    made: list[Bench] = []

    def make(*arguments: Any, **more: Any) -> Bench:
        made.append(Bench(tmp_path / str(len(made)), *arguments, **more))
        return made[-1]

    yield make
    for bench in made:
        bench.state.__exit__(None, None, None)
