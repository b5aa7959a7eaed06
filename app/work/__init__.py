"""Work that a request waits for, in processes of its own: within a limit of memory, and only while somebody waits."""
