from tests.command_line import cellslam

__all__ = ["cellslam"]
