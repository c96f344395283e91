"""`python -m gyrorig_daemon` is `gyrorigd`."""

from gyrorig_daemon.cli import main

if __name__ == "__main__":
    main()
