# The models folder of a live relightd: versions, settings, replaced and removed files.
prt_test(repository SOURCES service/repository.c LIBS librelight relight_proto LABELS service)
target_include_directories(test_repository PRIVATE ${CMAKE_CURRENT_SOURCE_DIR}/service)
add_dependencies(test_repository relightd prt_program)
