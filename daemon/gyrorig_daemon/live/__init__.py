"""Live view: the messages of a rig in Foxglove while they are recorded.

What to use when: `LiveView` is the interface and `NO_VIEW` the view that shows nothing;
`foxglove_view.open_live_view` opens the server of `gyrorigd run --live`.
"""

from gyrorig_daemon.live.foxglove_view import NO_VIEW, LiveView

__all__ = ["NO_VIEW", "LiveView"]
