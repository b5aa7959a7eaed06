"""The JSON that comes in and goes out, versioned: task specs, plan documents, and what is wrong with a body."""
