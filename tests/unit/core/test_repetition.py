"""Repetition: what is said holds within, and no longer; of one thread alone."""

from concurrent.futures import ThreadPoolExecutor

from torchbeam.core.repetition import one_of, repetitions


def test_within():
    with one_of(50.0), ThreadPoolExecutor(1) as pool:
        assert repetitions() == 50 and pool.submit(repetitions).result() == 1
        with one_of(0.1):
            assert repetitions() == 1
        assert repetitions() == 50
    assert repetitions() == 1
