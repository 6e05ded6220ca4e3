# A whole cluster on loopback, and the files that go with it. Visible skips where packages are missing.
add_test(NAME cluster COMMAND ${CMAKE_SOURCE_DIR}/deploy/cluster/try ${CMAKE_BINARY_DIR}/bin)
set_tests_properties(cluster PROPERTIES LABELS cluster SKIP_RETURN_CODE 77)
add_test(NAME proxy_tls COMMAND /usr/bin/python3 ${CMAKE_CURRENT_LIST_DIR}/proxy_tls.py ${CMAKE_BINARY_DIR}/bin
  ${CMAKE_BINARY_DIR}/python ${CMAKE_SOURCE_DIR}/deploy/cluster)
set_tests_properties(proxy_tls PROPERTIES LABELS cluster SKIP_RETURN_CODE 77)
add_test(NAME cluster_files COMMAND ${CMAKE_CURRENT_LIST_DIR}/files.sh ${CMAKE_SOURCE_DIR}/deploy/cluster
  ${CMAKE_BINARY_DIR})
set_tests_properties(cluster_files PROPERTIES LABELS cluster SKIP_RETURN_CODE 77)
add_test(NAME packages COMMAND ${CMAKE_CURRENT_LIST_DIR}/packages.sh ${CMAKE_BINARY_DIR})
set_tests_properties(packages PROPERTIES LABELS "cluster;long" SKIP_RETURN_CODE 77)
add_test(NAME packages_chroot COMMAND ${CMAKE_CURRENT_LIST_DIR}/packages_chroot.sh ${CMAKE_BINARY_DIR})
set_tests_properties(packages_chroot PROPERTIES TIMEOUT 2400 LABELS "cluster;long" SKIP_RETURN_CODE 77)
# The images: built without a registry, and run.
add_test(NAME images COMMAND python3 ${CMAKE_CURRENT_LIST_DIR}/image.py ${CMAKE_BINARY_DIR})
set_tests_properties(images PROPERTIES TIMEOUT 2400 LABELS "cluster;long" SKIP_RETURN_CODE 77)
# What one of something costs, and the simulation that reads it: half a minute of CPU, of bakes.
add_test(NAME capacity COMMAND sh -c "/usr/bin/python3 ${CMAKE_SOURCE_DIR}/deploy/cluster/capacity --bin \
${CMAKE_BINARY_DIR}/bin --pictures 8 --frames 40 --connections 50 --json ${CMAKE_BINARY_DIR}/figures.json && \
${CMAKE_SOURCE_DIR}/deploy/cluster/simulate --figures ${CMAKE_BINARY_DIR}/figures.json --users 20000 --models 1000 \
--replicas 2,3")
set_tests_properties(capacity PROPERTIES LABELS "cluster;long" SKIP_RETURN_CODE 77)
