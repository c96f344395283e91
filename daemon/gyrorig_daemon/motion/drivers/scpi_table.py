"""Driver of a rate table or servo with one axis, which understands SCPI-like text.

The defaults are commands in the style of SCPI-99: a query ends with `?`, a command is followed by
the query of the error queue, and `0,"No error"` acknowledges it. Makers choose their own words;
the key `commands` under `ptu` in the rig file replaces them. Not tested on a real rate table.
"""

from gyrorig_daemon.motion.text_language import NUMBER, TextLanguage
from gyrorig_daemon.motion.text_unit import text_driver
from gyrorig_protocol.ptu import Axis

LANGUAGE = TextLanguage(
    name="scpi_table",
    axes={Axis.PAN: "1"},
    identity=r"(?P<maker>[^,]+),(?P<model>[^,]*),(?P<serial>[^,]*),(?P<firmware>.*)",
    ready="OUTP ON;:SYST:ERR?|MODE POS;:SYST:ERR?",
    home="HOME;:SYST:ERR?",
    target="POS {value};:SYST:ERR?",
    speed="VEL {value};:SYST:ERR?",
    acceleration="ACC {value};:SYST:ERR?",
    halt="ABOR;:SYST:ERR?",
    accepted=r"[+]?0,.*",
    position="POS?;MOV?",
    positions=rf"(?P<pan>{NUMBER})(?:;(?P<moving>[01]))?",
    lowest="POS:LIM:LOW?",
    highest="POS:LIM:HIGH?",
    slowest="0.001",
    fastest="VEL:MAX?",
    rate_change="ACC?",
)
DRIVER = text_driver("rate table or servo with SCPI-like text, one axis", LANGUAGE)
