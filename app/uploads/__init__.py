"""Takes bodies, forms and files off the wire, within limits of size, time and memory."""
