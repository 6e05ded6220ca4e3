prt_test(librelight SOURCES service/librelight.c LIBS librelight LABELS service)
add_dependencies(test_librelight relightd prt_program)
