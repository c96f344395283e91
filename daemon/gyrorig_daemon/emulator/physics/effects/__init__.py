"""Imperfections of the emulated rig, one physical cause or family of causes a file."""
