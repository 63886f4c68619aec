"""The outside of jointplay: command line, HTTP service, web page and demo."""
