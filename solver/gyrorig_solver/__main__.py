"""`python -m gyrorig_solver` is the command `gyrorig`."""

from gyrorig_solver.cli import main

if __name__ == "__main__":
    main()
