prt_test(pose_index SOURCES unit/pose_index.c LIBS relightd_rooms LABELS unit)
