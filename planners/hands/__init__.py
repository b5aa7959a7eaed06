"""Two arms with hands, as both papers' planners see them: who may come how close, and the motion of one arm."""
