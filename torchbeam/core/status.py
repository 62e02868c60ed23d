"""Status of a sample: codes and their sentences."""

SUCCESS, DIVERGED, BROKEN, FAILED = range(4)
STATUS = {
    SUCCESS: "success",
    DIVERGED: "Newton's method did not converge; a smaller step may help",
    BROKEN: "a parameter, a load or the state is infinite or not a number",
    FAILED: "the explicit method failed: its step shrank to nothing, or the rates were not finite",
}
