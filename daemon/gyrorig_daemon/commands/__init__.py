"""The commands of `gyrorigd`, one module each; `command_group` has all of them.

Nothing is imported here: `gyrorigd halt` and `gyrorigd doctor` must start quickly, and also
on a computer where the rest of the program cannot be loaded.
"""
