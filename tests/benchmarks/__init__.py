"""Speed against peers: `python -m tests.benchmarks.NAME [--scene S] [--json FILE]`."""
