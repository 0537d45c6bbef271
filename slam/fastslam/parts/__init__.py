"""The replaceable parts of FastSLAM: association, criterion, clock."""
