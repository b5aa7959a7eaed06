"""What is told beside a scene: headline, figures, curves, rejections, certificate."""
