# Models without a bake, with a live relightd; the exact sum they are measured against is libprt's.
prt_test(instant SOURCES service/instant.c LIBS librelight prt LABELS service TIMEOUT 400)
target_include_directories(test_instant PRIVATE ${CMAKE_CURRENT_SOURCE_DIR}/service)
add_dependencies(test_instant relightd prt_program)
