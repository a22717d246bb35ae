// `outputs` of policy-server.yaml: where alerts are sent to.
#ifndef RIPS_POLICY_SERVER_SERVER_CONFIG_OUTPUT_CONFIG_H_
#define RIPS_POLICY_SERVER_SERVER_CONFIG_OUTPUT_CONFIG_H_

#include <cstddef>
#include <string>
#include <vector>

#include "absl/strings/string_view.h"
#include "services/runtime/config_reader.h"

namespace rips::server {

inline constexpr size_t kOutputsMax = 8;
inline constexpr size_t kOutputRobotsMax = 1'000;

// A receiver on the network, and how it is authenticated.
struct OutputEndpoint {
  // A name, or an address without brackets.
  std::string host;
  int port = 0;
  // False: plain TCP.
  bool tls = true;
  // Files in PEM, absolute paths. `ca`: whom to trust; empty = the certificates of the system.
  // `cert` and `key`: what we show; both or none.
  std::string ca;
  std::string cert;
  std::string key;

  friend bool operator==(const OutputEndpoint&, const OutputEndpoint&) = default;
};

struct OutputConfig {
  enum class Kind { kSyslog, kWebhook };
  enum class Format { kJson, kText, kOcsf };

  // A name as in IsValidName; no two are the same.
  std::string name;
  Kind kind = Kind::kSyslog;
  OutputEndpoint endpoint;
  // Of a webhook: path and query, such as `/rips`.
  std::string path;
  // Of a webhook: the file of the secret that signs; empty = nothing is signed.
  std::string secret_file;
  // kText of syslog only, kOcsf of a webhook only.
  Format format = Format::kJson;
  // info | low | medium | high | critical: the least that is sent.
  std::string severity = "info";
  // Ids of robots, or `(server)`; only their alerts are sent. Empty = all.
  std::vector<std::string> robots;

  friend bool operator==(const OutputConfig&, const OutputConfig&) = default;
};

// `syslog`, `webhook`.
absl::string_view ToString(OutputConfig::Kind kind);

// From 0 (info) to 4 (critical); -1 for another word.
int SeverityRank(absl::string_view severity);

// The list `outputs`, empty if absent. Problems are recorded in the reader of `root`.
std::vector<OutputConfig> ReadOutputs(const ConfigSection& root);

}  // namespace rips::server

#endif  // RIPS_POLICY_SERVER_SERVER_CONFIG_OUTPUT_CONFIG_H_
