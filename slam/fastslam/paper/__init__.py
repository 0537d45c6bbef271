"""The paper's FastSLAM as printed, without this project's corrections."""
