"""The viewer: a plan document played back in the browser, live or as one file.

`drawing` is what stands in the scene, `description` what is told beside it, `editor` the scene in which tasks are made,
and `static` the files of the pages. Here are the scenes' servers, what a page asks of them, and the page itself.
"""
