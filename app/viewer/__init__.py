"""The viewer: a plan document played back in the browser, live or as one file."""
