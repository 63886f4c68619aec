"""One machine over its life: what all its recordings, in the order they were made, say of its joints."""
