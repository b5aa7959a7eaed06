"""Free motion of the arms: path search, smooth paths, time laws."""
