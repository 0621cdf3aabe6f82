"""mantle: the application. Everything between the command line and the solver."""

__version__ = "0.1.0"
