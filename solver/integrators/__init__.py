"""Steps and their drivers: fixed or error-controlled, in lanes or on a device, and the kernels they run."""
