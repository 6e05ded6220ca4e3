prt_test(broken_models SOURCES fault/broken_models.c LIBS prt_mesh LABELS fault)
