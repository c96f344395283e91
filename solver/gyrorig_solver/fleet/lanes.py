"""Workers that may die: every piece of work comes to exactly one end.

What to use when: `through(orders, lanes)` for all work of a batch; `local_lanes` for
processes on this machine. Written against `concurrent.futures.Executor`, so that the same
loop drives any executor.

A process pool of the standard library breaks as a whole when one of its workers dies, and
does not say whose work killed it: of 60 pieces 41 were lost (reference: reliability.md
section 5). So each local lane is a pool of one worker: a death is told to the work that
the lane held, and the lane begins anew.
"""

import multiprocessing
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field

from gyrorig_protocol.errors import MachineError
from gyrorig_solver.fleet.limits import limit_memory
from gyrorig_solver.fleet.task import Order, Outcome, carry_out, row_of

DEATHS_ALLOWED = 1  # the second one is enough: such work is quarantined
LOOK_S = 2.0  # how long it may go unnoticed that a lane is gone
PRELOADED = ["gyrorig_solver.fleet.task", "gyrorig_solver.calibration.solving"]


def _never() -> bool:
    return False


def _shut_down(executor: Executor) -> None:
    executor.shutdown(wait=False, cancel_futures=True)


@dataclass(slots=True)
class Lane:
    """Where work is done: an executor, made anew when its workers are gone.

    `deaths` are what its futures raise when a worker died. `holds` is how many pieces are
    given to it at once. Where that is more than one, a death may be told to pieces that only
    waited beside the one that caused it: such are tried once more at the end, each alone.
    """

    make: Callable[[], Executor]
    holds: int = 1
    deaths: tuple[type[BaseException], ...] = (BrokenProcessPool,)
    tries: int = DEATHS_ALLOWED + 1  # how often work is given to it
    work: Callable[[Order], Outcome] = carry_out
    forsake: Callable[[Executor], None] = _shut_down
    is_gone: Callable[[], bool] = _never  # its futures will never come to an end
    executor: Executor | None = None
    held: dict["Future[Outcome]", Order] = field(default_factory=dict)

    def give(self, order: Order) -> None:
        """Begin one piece of work."""
        if self.executor is None:
            self.executor = self.make()
        try:
            future = self.executor.submit(self.work, order)
        except BrokenProcessPool:  # its idle worker died
            self.renew()
            self.executor = self.make()
            future = self.executor.submit(self.work, order)
        self.held[future] = order

    def renew(self) -> None:
        """Let the executor go; the next piece of work makes another."""
        if self.executor is not None:
            self.forsake(self.executor)
        self.executor = None


@dataclass(frozen=True, slots=True)
class PutOff:
    """Work that was not done and not recorded, because the machine or the store refused."""

    order: Order
    fault: MachineError


def local_lanes(workers: int, memory_bytes: int) -> list[Lane]:
    """Return lanes of one process each on this machine.

    The processes come from a server that has loaded the solver once: a new one costs
    milliseconds, not the second that the imports take.
    """
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(PRELOADED)

    def make() -> Executor:
        return ProcessPoolExecutor(
            1, mp_context=context, initializer=limit_memory, initargs=(memory_bytes,)
        )

    return [Lane(make) for _ in range(workers)]


def through(orders: Iterable[Order], lanes: list[Lane]) -> Iterator[Outcome | PutOff]:
    """Yield what comes of each order, as it comes.

    Orders are taken one by one as lanes become free, so they may be found while others are
    worked on. When the caller stops, what is held is not waited for.
    """
    waiting = iter(orders)
    again: list[Order] = []
    deaths: dict[str, int] = {}
    try:
        while True:
            refused = _fill(lanes, again, waiting)
            yield from map(_put_off, refused)
            futures = {future: lane for lane in lanes for future in lane.held}
            if not futures and not refused:
                return
            if not futures:
                continue
            done, _ = wait(futures, timeout=LOOK_S, return_when=FIRST_COMPLETED)
            if not done and (gone := [lane for lane in lanes if lane.is_gone()]):
                yield from (_put_off(order) for lane in gone for order in lane.held.values())
                return
            for future in done:
                lane = futures[future]
                order = lane.held.pop(future)
                told = _told(future, order, lane, deaths)
                if told is None:
                    again.append(order)
                else:
                    yield told
    finally:
        for lane in lanes:
            lane.renew()


def _put_off(order: Order) -> PutOff:
    return PutOff(order, MachineError("the workers are gone", "start them, and the batch, again"))


def _fill(lanes: list[Lane], again: list[Order], waiting: Iterator[Order]) -> list[Order]:
    """Give each lane what it holds; return what could not be given."""
    for lane in lanes:
        while len(lane.held) < lane.holds:
            order = _next(lane, again, waiting)
            if order is None:
                break
            try:
                lane.give(order)
            except Exception:  # a scheduler that has gone, a machine that starts no process
                return [order]
    return []


def _next(lane: Lane, again: list[Order], waiting: Iterator[Order]) -> Order | None:
    """Return what a lane is to do now; None: nothing, or nothing beside what it holds."""
    if again and lane.holds == 1:
        return again.pop()
    order = next(waiting, None)
    if order is None and again and not lane.held:  # alone: its death is its own
        return again.pop()
    return order


def _told(
    future: "Future[Outcome]", order: Order, lane: Lane, deaths: dict[str, int]
) -> Outcome | PutOff | None:
    """Return what came of an order; None: its worker died, and it may try once more."""
    try:
        return future.result()
    except MachineError as fault:
        return PutOff(order, fault)
    except lane.deaths as fault:
        if not lane.held:  # a shared executor goes on with the others' work
            lane.renew()
        deaths[order.key] = deaths.get(order.key, 0) + 1
        if deaths[order.key] < lane.tries:
            return None
        reason = f"it killed its worker again and again ({type(fault).__name__})"
        return Outcome(order.key, (row_of(order, "quarantined", reason=reason),))
    except Exception:  # of the way to the worker: a scheduler that is going, say
        return _put_off(order)
