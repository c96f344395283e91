"""Parts of `bench_daemon`: the load, who watches the daemon, and what the recording tells."""
