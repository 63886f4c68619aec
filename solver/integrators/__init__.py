"""Steps and their drivers: fixed or error-controlled, in lanes, and the kernels they run."""
