prt_test(proto SOURCES unit/proto.c unit/proto_vectors.c unit/proto_vectors_rooms.c unit/proto_vectors_access.c unit/proto_vectors_viewers.c
  fuzz/any_fields.c LIBS relight_proto LABELS unit)
target_compile_definitions(test_proto PRIVATE PROTO_VECTORS="${CMAKE_SOURCE_DIR}/proto/vectors")
target_include_directories(test_proto PRIVATE ${CMAKE_CURRENT_SOURCE_DIR}/fuzz)
