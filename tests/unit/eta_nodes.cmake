prt_test(eta_nodes SOURCES unit/eta_nodes.c LIBS prt_medium LABELS unit)
