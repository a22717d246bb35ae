#include "policy_server/server/config/output_config.h"

#include <algorithm>
#include <iterator>
#include <set>

#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/strip.h"
#include "services/base/ids.h"
#include "services/runtime/config_sections.h"

namespace rips::server {
namespace {

constexpr absl::string_view kSeverities[] = {"info", "low", "medium", "high", "critical"};
constexpr absl::string_view kServer = "(server)";
constexpr size_t kUrlBytesMax = 2'000;

// Without asking a name server: an answer of one must not decide whether text is encrypted.
bool IsLoopback(absl::string_view host) {
  return host == "localhost" || host == "::1" ||
         (absl::StartsWith(host, "127.") &&
          host.find_first_not_of("0123456789.") == absl::string_view::npos);
}

// `text` is as IsHostPort wants it.
void SplitHostPort(absl::string_view text, OutputEndpoint* endpoint) {
  const size_t colon = text.rfind(':');
  absl::string_view host = text.substr(0, colon);
  if (absl::ConsumePrefix(&host, "[")) absl::ConsumeSuffix(&host, "]");
  endpoint->host = std::string(host);
  if (!absl::SimpleAtoi(text.substr(colon + 1), &endpoint->port)) endpoint->port = 0;
}

void CheckPlain(const ConfigSection& section, absl::string_view key,
                const OutputEndpoint& endpoint) {
  bool plain = false;
  section.Optional("plain", &plain);
  if (endpoint.tls || plain || endpoint.host.empty() || IsLoopback(endpoint.host)) return;
  section.Problem(key, absl::StrCat("`", key,
                                    "` sends alerts unencrypted to another machine; use "
                                    "TLS, or write `plain: true` to allow it"));
}

void ReadFiles(const ConfigSection& section, OutputEndpoint* endpoint) {
  const auto read = [&](absl::string_view key, std::string* path) {
    if (section.Has(key)) ReadPath(section, key, path);
  };
  read("ca", &endpoint->ca);
  read("cert", &endpoint->cert);
  read("key", &endpoint->key);
  if (endpoint->cert.empty() != endpoint->key.empty()) {
    section.Problem("cert", "`cert` and `key` go together; write both or none");
  }
}

void ReadSyslogAddress(const ConfigSection& section, OutputEndpoint* endpoint) {
  std::string address;
  section.Required("address", &address);
  if (address.empty()) return;  // reported
  absl::string_view rest = address;
  endpoint->tls = !absl::ConsumePrefix(&rest, "tcp://");
  if (endpoint->tls) absl::ConsumePrefix(&rest, "tls://");
  if (IsHostPort(rest)) SplitHostPort(rest, endpoint);
  if (endpoint->port == 0) {
    section.Problem("address", absl::StrCat("`address` is `", address,
                                            "`; write `HOST:PORT`, for example "
                                            "`siem.example:6514`, or `tcp://127.0.0.1:514`"));
  }
}

// True if `url` was understood.
bool ParseUrl(absl::string_view url, OutputConfig* output) {
  if (url.size() > kUrlBytesMax) return false;
  const bool printable =
      std::all_of(url.begin(), url.end(), [](char c) { return c > 0x20 && c < 0x7F; });
  // A password in a URL would be shown by --check-config.
  if (!printable || url.find_first_of("@#\"\\<>`") != absl::string_view::npos) return false;
  OutputEndpoint& endpoint = output->endpoint;
  endpoint.tls = absl::ConsumePrefix(&url, "https://");
  if (!endpoint.tls && !absl::ConsumePrefix(&url, "http://")) return false;
  const size_t slash = std::min(url.find_first_of("/?"), url.size());
  std::string authority(url.substr(0, slash));
  const absl::string_view path = url.substr(slash);
  output->path = absl::StartsWith(path, "/") ? std::string(path) : absl::StrCat("/", path);
  if (!IsHostPort(authority)) absl::StrAppend(&authority, endpoint.tls ? ":443" : ":80");
  if (!IsHostPort(authority)) return false;
  SplitHostPort(authority, &endpoint);
  return endpoint.port != 0;
}

void ReadUrl(const ConfigSection& section, OutputConfig* output) {
  std::string url;
  section.Required("url", &url);
  if (url.empty() || ParseUrl(url, output)) return;
  section.Problem("url",
                  "`url` is not one that can be used; write `https://HOST[:PORT]/PATH` in "
                  "printable ASCII, without user, password and fragment, of 2,000 bytes at most");
}

void ReadRobots(const ConfigSection& section, std::vector<std::string>* robots) {
  section.Optional("robots", robots);
  if (robots->size() > kOutputRobotsMax) {
    section.Problem("robots",
                    absl::StrCat(robots->size(), " robots exceed limit ", kOutputRobotsMax));
  }
  for (const std::string& robot : *robots) {
    if (robot == kServer) continue;
    if (const absl::Status valid = ValidateName("robot id", robot); !valid.ok()) {
      section.Problem("robots", valid.message());
    }
  }
}

void ReadSecretFile(const ConfigSection& section, std::string* path) {
  section.Optional("secret_file", path);
  if (path->empty() || path->front() == '/') return;
  // Its value is not shown: it may be the secret.
  section.Problem("secret_file", "`secret_file` must be an absolute path");
}

OutputConfig ReadOutput(const ConfigSection& section) {
  using Kind = OutputConfig::Kind;
  using Format = OutputConfig::Format;
  OutputConfig output;
  ReadName(section, "name", "output name", &output.name);
  section.RequiredEnum<Kind>("kind", &output.kind,
                             {{"syslog", Kind::kSyslog}, {"webhook", Kind::kWebhook}});
  if (output.kind == Kind::kSyslog) {
    ReadSyslogAddress(section, &output.endpoint);
    ReadFiles(section.OptionalSection("tls"), &output.endpoint);
    section.OptionalEnum<Format>("format", &output.format,
                                 {{"json", Format::kJson}, {"text", Format::kText}});
    CheckPlain(section, "address", output.endpoint);
  } else {
    ReadUrl(section, &output);
    ReadFiles(section, &output.endpoint);
    ReadSecretFile(section, &output.secret_file);
    section.OptionalEnum<Format>("format", &output.format,
                                 {{"json", Format::kJson}, {"ocsf", Format::kOcsf}});
    CheckPlain(section, "url", output.endpoint);
  }
  section.Optional("severity", &output.severity);
  if (SeverityRank(output.severity) < 0) {
    section.Problem("severity", absl::StrCat("`severity` is `", output.severity,
                                             "`; write info, low, medium, high or critical"));
  }
  ReadRobots(section, &output.robots);
  return output;
}

}  // namespace

absl::string_view ToString(OutputConfig::Kind kind) {
  return kind == OutputConfig::Kind::kSyslog ? "syslog" : "webhook";
}

int SeverityRank(absl::string_view severity) {
  const auto* found = std::find(std::begin(kSeverities), std::end(kSeverities), severity);
  return found == std::end(kSeverities) ? -1 : static_cast<int>(found - std::begin(kSeverities));
}

std::vector<OutputConfig> ReadOutputs(const ConfigSection& root) {
  std::vector<OutputConfig> outputs;
  std::set<std::string> names;
  for (const ConfigSection& section : root.Sections("outputs")) {
    outputs.push_back(ReadOutput(section));
    const std::string& name = outputs.back().name;
    if (!name.empty() && !names.insert(name).second) {
      section.Problem("name", absl::StrCat("output `", name, "` is listed twice"));
    }
  }
  if (outputs.size() > kOutputsMax) {
    root.Problem("outputs", absl::StrCat(outputs.size(), " outputs exceed limit ", kOutputsMax));
  }
  return outputs;
}

}  // namespace rips::server
