"""Tells addresses that jobs have ended: where messages may go, how they are sent, and when again."""
