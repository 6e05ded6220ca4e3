prt_test(mesh_blob SOURCES unit/mesh_blob.c LIBS prt_mesh LABELS unit)
target_include_directories(test_mesh_blob PRIVATE ${CMAKE_SOURCE_DIR}/libprt)
