"""Statics: whether a hold bears the plate, whether the joints do, and how much is left."""
