"""`python -m gensp` is the console script."""

from gensp.cli import app

if __name__ == "__main__":
    app()
