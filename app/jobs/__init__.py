"""What computes or runs beside requests: worker processes, builds, deliveries of webhooks."""
