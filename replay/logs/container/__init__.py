"""Containers of messages: MCAP files and rosbag2 folders."""
