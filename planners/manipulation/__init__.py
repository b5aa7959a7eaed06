"""Paper B: contacts, dense contacts, holds and the manipulation state graph."""
