"""Command lines of the golden set that are not one of a family; `cases` has their syntax.

What to use when: add a line by the case's name, beside others of its kind.
"""

COMMANDS = {
    # the method of the paper, several recordings, one board of several
    "paper-plain": "gyrorig solve {rec-plain}/*.mcap --method paper --out {out} --json",
    "paper-quick": "gyrorig solve {rec-quick}/*.mcap --method paper --out {out} --json",
    "solve-together": "gyrorig solve {rec-rest}/*.mcap {rec-quick}/*.mcap {rec-plain}/*.mcap "
    "--extend none --out {out} --json",
    "solve-one-of-four": "gyrorig solve {rec-four}/*.mcap --board B2 --extend none --out {out} "
    "--json",
    "solve-text": "gyrorig solve {rec-plain}/*.mcap --out {out}",
    "explain-together": "gyrorig explain {rec-quick}/*.mcap {rec-plain}/*.mcap --out {out} --json",
    "explain-held-out": "gyrorig explain {rec-plain}/*.mcap --held-out {rec-quick}/*.mcap "
    "--out {out} --json",
    "explain-four": "gyrorig explain {rec-four}/*.mcap --out {out} --json",
    "explain-one-of-four": "gyrorig explain {rec-four-pan}/*.mcap --board B3 --out {out} --json",
    "explain-text": "gyrorig explain {rec-backlash}/*.mcap --out {out}",
    "check-text": "gyrorig check {rec-plain}/*.mcap",
    "check-several": "gyrorig check {rec-quick}/*.mcap {text}/text.mcap --json",
    "report": "gyrorig report {solve-plain}/GY80-1/v0001.yaml {rec-plain}/*.mcap "
    "-o {out}/page.html --json",
    "report-alone": "gyrorig report {solve-four}/B1/v0001.yaml -o {out}/page.html --json",
    "demo-bad-cause": "gyrorig demo --hide gremlins --out {out} --json",
    # other references
    "import-attitude": "gyrorig import npz {attitude}/log.npz --map {attitude}/map.yaml "
    "--out {out}/log.mcap --json",
    "solve-attitude": "gyrorig solve {import-attitude}/log.mcap --out {out} --json",
    "explain-attitude": "gyrorig explain {import-attitude}/log.mcap --out {out} --json",
    "extend-attitude": "gyrorig solve {import-attitude}/log.mcap --extend scale_cubic "
    "--out {out} --json",
    "import-turns": "gyrorig import csv {turns}/log.csv --map {turns}/map.yaml "
    "--out {out}/log.mcap --json",
    "check-turns": "gyrorig check {import-turns}/log.mcap --json",
    "solve-turns": "gyrorig solve {import-turns}/log.mcap --out {out} --json",
    "explain-turns": "gyrorig explain {import-turns}/log.mcap --out {out} --json",
    "import-gravity": "gyrorig import npz {gravity}/log.npz --map {gravity}/map.yaml "
    "--out {out}/log.mcap --json",
    "check-gravity": "gyrorig check {import-gravity}/log.mcap --json",
    "solve-gravity": "gyrorig solve {import-gravity}/log.mcap --out {out} --json",
    "import-phone": "gyrorig import android {phone}/GyroscopeUncalibrated.csv "
    "--beside {rec-plain}/*.mcap --board NEXUS5 --sensor MPU-6515 --out {out}/log.mcap --json",
    "solve-phone": "gyrorig solve {import-phone}/log.mcap --board NEXUS5 --extend none --out {out} "
    "--json",
    # applied and exported
    "apply-recording": "gyrorig apply {solve-plain}/GY80-1/v0001.yaml {rec-quick}/*.mcap "
    "-o {out}/true.mcap --json",
    "apply-sensor-frame": "gyrorig apply {solve-plain}/GY80-1/v0001.yaml {rec-quick}/*.mcap "
    "--frame sensor -o {out}/true.mcap --json",
    "apply-thermal": "gyrorig apply {extend-thermal}/GY80-1/v0001.yaml {rec-thermal}/*.mcap "
    "-o {out}/true.mcap --json",
    "apply-table": "gyrorig apply {solve-plain}/GY80-1/v0001.yaml {turns}/log.csv "
    "--columns gx,gy,gz --unit deg/s --time t -o {out}/true.csv --json",
    "apply-bias-only": "gyrorig apply {solve-plain}/GY80-1/v0001.yaml {turns}/log.csv "
    "--columns gx,gy,gz --unit deg/s --bias-only -o {out}/true.csv --json",
    "export-c": "gyrorig export {solve-plain}/GY80-1/v0001.yaml --format c -o {out}/x.h",
    "export-c-thermal": "gyrorig export {extend-thermal}/GY80-1/v0001.yaml --format c "
    "--name warm --frame sensor -o {out}/x.h",
    "export-ros": "gyrorig export {solve-plain}/GY80-1/v0001.yaml --format ros -o {out}/x.yaml",
    "export-kalibr": "gyrorig export {solve-plain}/GY80-1/v0001.yaml --format kalibr "
    "-o {out}/x.yaml",
    "export-px4": "gyrorig export {extend-thermal}/GY80-1/v0001.yaml --format px4 --slot 1 "
    "--device-id 1310988 -o {out}/x.params",
    "export-refused": "gyrorig export {extend-plain}/GY80-1/v0001.yaml --format px4",
    "export-ardupilot": "gyrorig export {solve-plain}/GY80-1/v0001.yaml --format ardupilot "
    "-o {out}/x.parm",
    "export-json": "gyrorig export {solve-plain}/GY80-1/v0001.yaml --format json -o {out}/x.json",
    # planned
    "plan-search": "gyrorig plan --rig config/rig.yaml --seconds 25 --no-causes "
    "--output {out}/planned.yaml --json",
    "plan-program": "gyrorig plan --rig config/rig.yaml --program config/programs/quick.yaml "
    "--json",
    "plan-rest": "gyrorig plan --rig config/rig.yaml --program config/programs/static.yaml --json",
    "plan-sensor": "gyrorig plan --rig config/rig.yaml --program config/programs/survey-40.yaml "
    "--sensor BMI270 --no-causes --json",
    # a fleet in a folder
    "batch-folder": "gyrorig batch --spool {spool} --store {out}/store --workers 1 "
    "--extend none --json",
    "batch-auto": "gyrorig batch --spool {spool-backlash} --store {out}/store --workers 1 "
    "--extend auto --json",
    "store-ls": "gyrorig store ls {batch-folder}/store --all --json",
    "store-wrong": "gyrorig store ls {batch-folder}/store --wrong --json",
    "store-diff": "gyrorig store diff {batch-folder}/store GY80-1 --json",
    "store-show": "gyrorig store show {batch-folder}/store GY80-1 --version 1 --json",
    "store-verify": "gyrorig store verify {batch-folder}/store --json",
    "fleet-folder": "gyrorig fleet {batch-folder}/store --boards {fleet-table}/boards.csv "
    "--out {out}/page --json",
    # a fleet in a bucket
    "batch-bucket": "gyrorig batch --spool {spool} --store s3://fleet/calibrations --workers 1 "
    "--extend none "
    "--json",
    "bucket-ls": "gyrorig store ls s3://fleet/calibrations --all --json",
    "bucket-diff": "gyrorig store diff s3://fleet/calibrations GY80-1 --json",
    "bucket-verify": "gyrorig store verify s3://fleet/calibrations --json",
    "bucket-fleet": "gyrorig fleet s3://fleet/calibrations --out {out}/page --json",
    # damaged, empty and foreign input
    "check-truncated": "gyrorig check {truncated}/cut.mcap --json",
    "solve-truncated": "gyrorig solve {truncated}/cut.mcap --out {out} --json",
    "check-part": "gyrorig check {truncated}/cut.mcap.part --json",
    "check-damaged": "gyrorig check {damaged}/flipped.mcap --json",
    "solve-damaged": "gyrorig solve {damaged}/flipped.mcap --out {out} --json",
    "explain-damaged": "gyrorig explain {damaged}/flipped.mcap --out {out} --json",
    "check-empty": "gyrorig check {text}/empty.mcap --json",
    "solve-empty": "gyrorig solve {text}/empty.mcap --out {out} --json",
    "check-foreign": "gyrorig check {text}/text.mcap --json",
    "explain-foreign": "gyrorig explain {text}/text.mcap --out {out} --json",
    "solve-no-file": "gyrorig solve {text}/none.mcap --out {out} --json",
    "export-foreign": "gyrorig export {text}/foreign.yaml --format c",
    "export-findings": "gyrorig export {explain-plain}/GY80-1/findings.yaml --format c",
    "apply-foreign": "gyrorig apply {text}/text.mcap {turns}/log.csv -o {out}/x.csv --json",
    "import-foreign": "gyrorig import csv {text}/text.mcap --map {turns}/map.yaml "
    "--out {out}/x.mcap --json",
    "import-bad-map": "gyrorig import csv {turns}/log.csv --map {text}/foreign.yaml "
    "--out {out}/x.mcap --json",
    "import-android-foreign": "gyrorig import android {text}/text.mcap --out {out}/x.mcap --json",
    "fleet-no-store": "gyrorig fleet {text} --json",
    "store-no-board": "gyrorig store show {batch-folder}/store NOBODY --json",
    # misuse
    "solve-no-board": "gyrorig solve {rec-quick}/*.mcap --board NOBODY --out {out} --json",
    "solve-bad-cause": "gyrorig solve {rec-quick}/*.mcap --extend gremlins --out {out} --json",
    "solve-bad-method": "gyrorig solve {rec-quick}/*.mcap --method guess --out {out} --json",
    "explain-two-rigs": "gyrorig explain {rec-quick}/*.mcap {rec-four}/*.mcap --out {out} --json",
    "export-bad-format": "gyrorig export {solve-plain}/GY80-1/v0001.yaml --format morse",
    "plan-too-short": "gyrorig plan --rig config/rig.yaml --seconds 20 --json",
    "no-command": "gyrorig calibrate",
    "record-bad-cause": "gyrorigd record --simulated-time --config config/rig.yaml "
    "--program config/programs/quick.yaml --hide gremlins --out {out} --json",
    "record-bad-rig": "gyrorigd record --simulated-time --config {text}/foreign.yaml "
    "--program config/programs/quick.yaml --out {out} --json",
    "record-too-far": "gyrorigd record --simulated-time --config config/rig.yaml "
    "--program {programs}/too-far.yaml --out {out} --json",
    "record-not-homed": "gyrorigd record --simulated-time --config {rigs}/not-homed.yaml "
    "--program config/programs/quick.yaml --out {out} --json",
    "causes": "gyrorigd causes",
    "doctor-bad-rig": "gyrorigd doctor --config {text}/foreign.yaml --json",
    # measured data of others, where they are
    "import-broad": "gyrorig import broad data/broad/02_undisturbed_slow_rotation_B.npz "
    "--board IMU-1 --out {out}/log.mcap --json",
    "solve-broad": "gyrorig solve {import-broad}/log.mcap --out {out} --json",
    "import-ferraris": "gyrorig import imucal-ferraris "
    "data/imucal_ferraris/example_ferraris_session.csv --out {out}/log.mcap --json",
    "solve-ferraris": "gyrorig solve {import-ferraris}/log.mcap --out {out} --json",
    "import-xsens": "gyrorig import imu-tk-xsens data/imu_tk_xsens/xsens_raw.npz "
    "--out {out}/log.mcap --json",
    "solve-xsens": "gyrorig solve {import-xsens}/log.mcap --out {out} --json",
    "check-sample": "gyrorig check contracts/sample.mcap --json",
    "solve-sample": "gyrorig solve contracts/sample.mcap --out {out} --json",
}
