"""What the residual says: noise, evidence, held-out blocks, and the selection of effects."""
