"""The scenarios that cellslam ships, a .toml file each."""
