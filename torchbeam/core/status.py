"""Status of a sample: codes and their sentences."""

SUCCESS, DIVERGED, BROKEN, FAILED, UNDERFLOW, TOO_MANY = range(6)
STATUS = {
    SUCCESS: "success",
    DIVERGED: "Newton's method did not converge; a smaller step may help",
    BROKEN: "a parameter, a load or the state is infinite or not a number",
    FAILED: (
        "the explicit method failed: its step shrank to nothing, the rates were not finite, "
        "or it made energy that nothing gave"
    ),
    UNDERFLOW: (
        "no step, however short, has an error within the tolerance, or a solution at all: "
        "something jumps, is not finite, or the tolerance is beyond what the arithmetic "
        "resolves"
    ),
    TOO_MANY: "the tolerance was not reached within max_steps; a larger one of either may help",
}
