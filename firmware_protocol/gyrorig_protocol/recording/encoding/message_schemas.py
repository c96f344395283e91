"""Message schemas of format 1: `ros2msg` texts with all dependencies.

What to use when: `SCHEMAS` to register a channel or to compare with the schema in a file.
`message_layouts` has the numpy layouts.

Source of the standard messages: diagnostic_msgs and rcl_interfaces of ROS 2.
"""

from collections.abc import Mapping
from types import MappingProxyType

# The separator of concatenated definitions, as the MCAP registry defines `ros2msg`.
SEPARATOR = "=" * 80

_TIME = "int32 sec\nuint32 nanosec\n"
_HEADER = "builtin_interfaces/Time stamp\nstring frame_id\n"
_KEY_VALUE = "string key\nstring value\n"

_DIAGNOSTIC_STATUS = """\
byte OK=0
byte WARN=1
byte ERROR=2
byte STALE=3
byte level
string name
string message
string hardware_id
diagnostic_msgs/KeyValue[] values
"""


def _with_dependencies(text: str, **dependencies: str) -> str:
    """Append each dependency (`pkg__Type` = text) to a definition."""
    sections = [text]
    for name, body in dependencies.items():
        sections.append(f"{SEPARATOR}\nMSG: {name.replace('__', '/')}\n{body}")
    return "".join(sections)


IMU_RAW = _with_dependencies(
    """\
builtin_interfaces/Time host_time
uint64 device_time
uint32 sequence
uint16 status
int16 temperature
int32[3] gyro
int32[3] accel
int32[3] mag
""",
    builtin_interfaces__Time=_TIME,
)

PTU_POSITION = _with_dependencies(
    """\
builtin_interfaces/Time request_time
builtin_interfaces/Time first_byte_time
builtin_interfaces/Time reply_time
int32 pan_steps
int32 tilt_steps
float64 pan
float64 tilt
uint64 controller_time
uint32 sequence
uint16 status
""",
    builtin_interfaces__Time=_TIME,
)

PTU_COMMAND = _with_dependencies(
    """\
uint8 OK=0
uint8 ERROR=1
uint8 TIMEOUT=2
uint8 LIMIT=3
builtin_interfaces/Time request_time
builtin_interfaces/Time first_byte_time
builtin_interfaces/Time reply_time
uint32 sequence
uint8 code
string command
string reply
""",
    builtin_interfaces__Time=_TIME,
)

MOTION_ORDER = _with_dependencies(
    """\
uint8 PAN=0
uint8 TILT=1
uint8 BOTH=2
uint8 TARGET=0
uint8 OFFSET=1
uint8 SPEED=2
uint8 SPEED_CHANGE=3
uint8 RATE=4
uint8 RATE_CHANGE=5
uint8 BASE_SPEED=6
uint8 ACCELERATION=7
uint8 HALT=8
uint8 COLLECT=9
uint8 START=10
uint8 IMMEDIATE=11
uint8 HOME=12
uint8 RESOLUTION=13
builtin_interfaces/Time request_time
builtin_interfaces/Time first_byte_time
builtin_interfaces/Time reply_time
float64 value
float64 steps
float64 speed_steps
uint32 sequence
uint16 command_bytes
uint8 axis
uint8 kind
uint8 accepted
""",
    builtin_interfaces__Time=_TIME,
)

SESSION_EVENT = _with_dependencies(
    """\
uint8 PHASE_BEGIN=0
uint8 PHASE_END=1
uint8 NOTE=2
uint8 FAULT=3
builtin_interfaces/Time host_time
uint8 kind
string phase
string text
""",
    builtin_interfaces__Time=_TIME,
)

CLOCK_PING = _with_dependencies(
    """\
builtin_interfaces/Time host_send
builtin_interfaces/Time host_receive
uint64 device_receive
uint64 device_send
uint32 nonce
uint16 status
""",
    builtin_interfaces__Time=_TIME,
)

HOST_CLOCK = _with_dependencies(
    """\
builtin_interfaces/Time monotonic_raw
builtin_interfaces/Time monotonic
builtin_interfaces/Time realtime
float64 frequency_ppm
float64 estimated_error
uint32 ntp_status
""",
    builtin_interfaces__Time=_TIME,
)

REFERENCE_ATTITUDE = _with_dependencies(
    """\
builtin_interfaces/Time host_time
float64[4] orientation
float64 standard_deviation
uint16 status
""",
    builtin_interfaces__Time=_TIME,
)

DIAGNOSTIC_ARRAY = _with_dependencies(
    "std_msgs/Header header\ndiagnostic_msgs/DiagnosticStatus[] status\n",
    std_msgs__Header=_HEADER,
    builtin_interfaces__Time=_TIME,
    diagnostic_msgs__DiagnosticStatus=_DIAGNOSTIC_STATUS,
    diagnostic_msgs__KeyValue=_KEY_VALUE,
)

LOG = _with_dependencies(
    """\
byte DEBUG=10
byte INFO=20
byte WARN=30
byte ERROR=40
byte FATAL=50
builtin_interfaces/Time stamp
uint8 level
string name
string msg
string file
string function
uint32 line
""",
    builtin_interfaces__Time=_TIME,
)

SCHEMAS: Mapping[str, str] = MappingProxyType(
    {
        "gyrorig_msgs/msg/ImuRaw": IMU_RAW,
        "gyrorig_msgs/msg/PtuPosition": PTU_POSITION,
        "gyrorig_msgs/msg/PtuCommand": PTU_COMMAND,
        "gyrorig_msgs/msg/MotionOrder": MOTION_ORDER,
        "gyrorig_msgs/msg/SessionEvent": SESSION_EVENT,
        "gyrorig_msgs/msg/ClockPing": CLOCK_PING,
        "gyrorig_msgs/msg/HostClock": HOST_CLOCK,
        "gyrorig_msgs/msg/ReferenceAttitude": REFERENCE_ATTITUDE,
        "diagnostic_msgs/msg/DiagnosticArray": DIAGNOSTIC_ARRAY,
        "rcl_interfaces/msg/Log": LOG,
    }
)
