"""Presets: IMUs that need no DBC file; their messages as DBC text and their signals.

    j1939      SAE J1939 angular rate (PGN 61482) and acceleration (PGN 61485), as Aceinna's
               OpenIMU and MTLT send them. Source: Aceinna, "CAN J1939 Data Messages" (table
               of the angular rate and acceleration packets); J1939-71 for the codes above
               0xFAFF, which are not values.
    mm5.10     Bosch Motorsport MM5.10. Yaw and roll only: x and z; beyond 163.8 deg/s it clips.
               Source: Bosch ABS M5 Kit manual, "CAN protocol", MM5.10.
    racelogic  Racelogic IMU03 and IMU04 at their default identifiers. Yaw is positive
               clockwise there. Source: Racelogic Support Centre, "CAN Output - IMU04".

The axes are those named by the manufacturer; the solver estimates the mounting on the rig. None of
the three sends a timestamp or a counter.
"""

from dataclasses import dataclass

AxisSignals = tuple[
    str | None, str | None, str | None
]  # "MESSAGE.SIGNAL"; None: the sensor lacks the axis


@dataclass(frozen=True, slots=True)
class ImuPreset:
    """One kind of IMU: its DBC text and the names of its signals."""

    dbc: str
    gyro: AxisSignals
    accel: AxisSignals | None = None
    temperature: str | None = None
    uses_source_address: bool = (
        False  # J1939: the last byte of the identifier is the sender's address
    )
    check_range: bool = False  # values outside [minimum|maximum] are invalid
    sensor: str = ""


_J1939 = """\
VERSION ""
BS_:
BU_: IMU
BO_ 2364549886 ARI: 8 IMU
 SG_ RateX : 0|16@1+ (0.0078125,-250) [-250|251.9921875] "deg/s" Vector__XXX
 SG_ RateY : 16|16@1+ (0.0078125,-250) [-250|251.9921875] "deg/s" Vector__XXX
 SG_ RateZ : 32|16@1+ (0.0078125,-250) [-250|251.9921875] "deg/s" Vector__XXX
BO_ 2297441790 ACCS: 8 IMU
 SG_ AccelX : 0|16@1+ (0.01,-320) [-320|322.55] "m/s2" Vector__XXX
 SG_ AccelY : 16|16@1+ (0.01,-320) [-320|322.55] "m/s2" Vector__XXX
 SG_ AccelZ : 32|16@1+ (0.01,-320) [-320|322.55] "m/s2" Vector__XXX
"""

_MM5_10 = """\
VERSION ""
BS_:
BU_: MM5_10
BO_ 112 TX1: 8 MM5_10
 SG_ YawRate : 0|16@1+ (0.005,-163.84) [-163.84|163.835] "deg/s" Vector__XXX
 SG_ AccelY : 32|16@1+ (0.000127465,-4.1768) [-4.1768|4.1765] "g" Vector__XXX
BO_ 128 TX2: 8 MM5_10
 SG_ RollRate : 0|16@1+ (0.005,-163.84) [-163.84|163.835] "deg/s" Vector__XXX
 SG_ AccelX : 32|16@1+ (0.000127465,-4.1768) [-4.1768|4.1765] "g" Vector__XXX
BO_ 1398 TX3: 8 MM5_10
 SG_ AccelZ : 32|16@1+ (0.000127465,-4.1768) [-4.1768|4.1765] "g" Vector__XXX
"""

_RACELOGIC = """\
VERSION ""
BS_:
BU_: IMU
BO_ 1536 YawX: 8 IMU
 SG_ YawRate : 7|32@0- (1,0) [0|0] "deg/s" Vector__XXX
 SG_ AccelX : 39|32@0- (1,0) [0|0] "g" Vector__XXX
BO_ 1537 YTemperature: 8 IMU
 SG_ AccelY : 7|32@0- (1,0) [0|0] "g" Vector__XXX
 SG_ Temperature : 39|32@0- (1,0) [0|0] "degC" Vector__XXX
BO_ 1538 PitchRoll: 8 IMU
 SG_ PitchRate : 7|32@0- (1,0) [0|0] "deg/s" Vector__XXX
 SG_ RollRate : 39|32@0- (1,0) [0|0] "deg/s" Vector__XXX
BO_ 1539 Z: 8 IMU
 SG_ AccelZ : 7|32@0- (1,0) [0|0] "g" Vector__XXX
SIG_VALTYPE_ 1536 YawRate : 1;
SIG_VALTYPE_ 1536 AccelX : 1;
SIG_VALTYPE_ 1537 AccelY : 1;
SIG_VALTYPE_ 1537 Temperature : 1;
SIG_VALTYPE_ 1538 PitchRate : 1;
SIG_VALTYPE_ 1538 RollRate : 1;
SIG_VALTYPE_ 1539 AccelZ : 1;
"""

PRESETS = {
    "j1939": ImuPreset(
        _J1939,
        ("ARI.RateX", "ARI.RateY", "ARI.RateZ"),
        ("ACCS.AccelX", "ACCS.AccelY", "ACCS.AccelZ"),
        uses_source_address=True,
        check_range=True,
        sensor="J1939 angular rate sensor",
    ),
    "mm5.10": ImuPreset(
        _MM5_10,
        ("TX2.RollRate", None, "TX1.YawRate"),
        ("TX2.AccelX", "TX1.AccelY", "TX3.AccelZ"),
        sensor="MM5.10",
    ),
    "racelogic": ImuPreset(
        _RACELOGIC,
        ("PitchRoll.RollRate", "PitchRoll.PitchRate", "YawX.YawRate"),
        ("YawX.AccelX", "YTemperature.AccelY", "Z.AccelZ"),
        "YTemperature.Temperature",
        sensor="Racelogic IMU",
    ),
}
