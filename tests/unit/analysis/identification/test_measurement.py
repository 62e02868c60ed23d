"""A measurement, as it is printed."""

import math

import torchbeam as tb


def test_it_is_printed_in_a_line():
    """However long the series is."""
    values = [[0.1 * k, math.nan] for k in range(500)]
    laser = tb.Measurement(values, times=[0.01 * k for k in range(500)], name="laser")
    assert repr(laser) == (
        "Measurement(data of 'laser': (500, 2) numbers, 0 to 49.9 at 0 to 4.99 s)"
    )
    assert repr(tb.Measurement([1, 2])) == "Measurement(data: (2,) numbers, 1 to 2)"
