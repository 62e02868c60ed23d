"""torchbeam: batched, differentiable, geometrically exact beam dynamics in PyTorch."""
