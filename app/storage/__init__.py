"""Rows and files of the service: recordings, results, keys, assets, builds, webhooks."""
