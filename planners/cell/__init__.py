"""The cell: arms with their hands and everything bolted down around them, from the files of the assets folder."""
