"""The other methods of the paper's tables, one file each, with the loss of its publication.

Every one is a `types.Model`. CasMVSNet, "MVS + UNet features" and the SAM rows are assemblies of
our own parts in `assemblies/`.
"""
