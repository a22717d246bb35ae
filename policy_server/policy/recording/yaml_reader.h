// The event stream of the RIPS prototype: YAML documents between `---` and `...`,
//
//   event: message            any other word is an event that is not judged
//   fromtopic: /chatter       of a message
//   rawmsg: |                 of a message: base64 of the serialized payload; line breaks are free
//     AAEAAAYAAABoZWxsbwA=
//   context:                  the graph from here on; without it the graph stays as it was
//     nodes:
//       - node: talker
//         services: [{service: /talker/get_parameters, params: rcl_interfaces/srv/GetParameters}]
//     topics:
//       - {topic: /chatter, parameters: [std_msgs/msg/String], publishers: [talker],
//          subscribers: [~]}
//
// `[~]` is an empty list, and so is null or nothing. Unknown keys are ignored. Documents without
// content are not events. There are no times and no senders.
//
// Graph: a name without a slash lies in `/`. Each entry of `nodes` is one node, also under a name
// that is there already; each entry of `publishers` and `subscribers` one endpoint, given to the
// nodes of that name in turn. Who publishes or subscribes without being listed is a node too. The
// types of a topic go to its endpoints in turn; types beyond their number, and topics without
// endpoints, are not in the graph. A type `std_msgs/String` means `std_msgs/msg/String`. GUIDs are
// made up: the same for the same node throughout the file. `gids` are ignored.
//
// The type of a message is the first that the graph names for its topic; else empty. A message
// without `rawmsg` has a payload that is not known.
//
// Memory: one document. The last document need not be ended by `...`, except after one that is;
// then it was cut.
#ifndef RIPS_POLICY_SERVER_POLICY_RECORDING_YAML_READER_H_
#define RIPS_POLICY_SERVER_POLICY_RECORDING_YAML_READER_H_

#include <cstddef>
#include <memory>

#include "absl/status/statusor.h"
#include "policy_server/policy/recording/input_file.h"
#include "policy_server/policy/recording/reader.h"

namespace rips::recording {

// Text of one document, bytes. Inclusive.
inline constexpr size_t kYamlDocumentBytesMax = size_t{16} << 20;

// Errors name the document (0-based, as events are) and the line (1-based). `file` stands at its
// first byte.
absl::StatusOr<std::unique_ptr<Reader>> OpenYaml(std::unique_ptr<InputFile> file);

}  // namespace rips::recording

#endif  // RIPS_POLICY_SERVER_POLICY_RECORDING_YAML_READER_H_
