"""Maps as PNG pictures, in colours that everybody tells apart."""
