"""`python -m gyrorig_daemon` runs `gyrorigd`."""

from gyrorig_daemon.cli import main

if __name__ == "__main__":
    main()
