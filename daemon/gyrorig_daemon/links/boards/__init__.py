"""Boards: `board_factory` makes the links of a rig, `board_link` is the link to one board."""
