"""Systems whose answers are known by an independent way: ``python -m tests.corpus``."""
