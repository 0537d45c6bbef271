"""The extended FastSLAM and its replaceable parts."""
