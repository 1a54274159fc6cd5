"""Figures of reproduced results, replays and benchmarks."""
