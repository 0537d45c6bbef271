"""The replaceable parts of FastSLAM: association, criterion, landmarks, clock, proposal."""
