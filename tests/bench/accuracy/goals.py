"""What is measured and what must be reached: the one table of goals, set before any run."""

from tests.bench.accuracy.trial import Case

SHORT, LONG = "planned-75.yaml", "planned-300.yaml"

KNOWN_EFFICIENCY, ANSWERS_EFFICIENCY = 0.95, 0.90
COVER_68, COVER_95 = (0.64, 0.72), (0.93, 0.97)
OFFSET_RATIO, OFFSET_COVER = 1.15, (0.92, 0.98)
OUTLIER_LOSS = 0.05
CHI2_P = 0.01


def _short(
    name: str, baud: float | None = None, counter: bool = False, spikes: float = 0.0
) -> Case:
    return Case(
        f"75 s, {name}",
        SHORT,
        number=1,
        baud=baud,
        counter=counter,
        spikes=spikes,
    )


def _fast(name: str, baud: float | None = None, spikes: float = 0.0) -> Case:
    return Case(
        f"75 s, 800 Hz, {name}",
        SHORT,
        number=2,
        rate_hz=800.0,
        bandwidth_hz=110.0,
        baud=baud,
        spikes=spikes,
        share=0.5,
    )


def _long(name: str, baud: float | None = None) -> Case:
    return Case(f"300 s, {name}", LONG, number=3, baud=baud)


CASES = (
    _short("known"),
    _short("115200 baud", 115_200.0),
    _short("9600 baud", 9600.0),
    _short("counter, 115200 baud", 115_200.0, counter=True),
    _short("counter, 9600 baud", 9600.0, counter=True),
    _short("known, spikes", spikes=0.01),
    _long("known"),
    _long("115200 baud", 115_200.0),
    _long("9600 baud", 9600.0),
    _fast("known"),
    _fast("known, spikes", spikes=0.01),
    _fast("115200 baud", 115_200.0),
)
