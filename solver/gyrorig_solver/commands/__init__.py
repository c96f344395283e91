"""The commands of `gyrorig`, one module each; `gyrorig_solver.cli` loads them when asked for.

A command is called NAME_command, takes the `terminal.Terminal` that it speaks through,
and returns its exit code. Errors are raised; `gyrorig_solver.cli` turns them into a line.
"""
