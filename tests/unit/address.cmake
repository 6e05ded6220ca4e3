prt_test(address SOURCES unit/address.c LIBS relightd_rooms LABELS unit)
