"""From what cameras see to a scene: the tool by its markers, the objects by their top facets (paper A, V.A)."""
