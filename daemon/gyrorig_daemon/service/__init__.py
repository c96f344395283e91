"""The daemon as a service: `gyrorigd run` and what talks to it.

What to use when: `start.Service` is the whole process; `daemon.Daemon` the loop on one opened
rig, which also runs under simulated time; `jobs.put` hands a session in; `client.ask` asks a
running daemon. docs/service.md is the page for those who run it.
"""
