# The shared folder on NFS, in a Linux of its own: the property test of the store, and two relightd.
if(NOT PRT_SANITIZE AND CMAKE_SYSTEM_PROCESSOR STREQUAL x86_64)
  add_library(uml_registers SHARED ${CMAKE_CURRENT_LIST_DIR}/uml_registers.c)
  target_link_libraries(uml_registers PRIVATE prt_options)
endif()
add_test(NAME nfs COMMAND ${CMAKE_CURRENT_LIST_DIR}/nfs.py ${CMAKE_BINARY_DIR} BUILD/tests/test_object_store)
add_test(NAME nfs_replicas COMMAND ${CMAKE_CURRENT_LIST_DIR}/nfs.py ${CMAKE_BINARY_DIR}
  "cd TESTS/service && exec /usr/bin/python3 replicas.py BUILD/bin BUILD/python 300")
# Records alone, which replace each other most often: names go stale.
add_test(NAME nfs_records COMMAND ${CMAKE_CURRENT_LIST_DIR}/nfs.py ${CMAKE_BINARY_DIR}
  "OBJECT_RECORDS=1 OBJECT_KILLS=900 exec BUILD/tests/test_object_store")
set_tests_properties(nfs nfs_replicas nfs_records PROPERTIES SKIP_RETURN_CODE 77 TIMEOUT 1200 LABELS cluster)
set_tests_properties(nfs_replicas nfs_records PROPERTIES LABELS "cluster;long")
