"""What a material lies on: where a camera's rays meet it, and which texel lies there."""
