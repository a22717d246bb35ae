#include "policy_server/server/outputs/webhook_receiver.h"

#include <openssl/evp.h>
#include <openssl/hmac.h>

#include <algorithm>
#include <iterator>
#include <memory>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/strip.h"
#include "policy_server/server/outputs/connection.h"
#include "policy_server/server/outputs/ocsf_format.h"
#include "policy_server/server/store/alert_log.h"
#include "services/base/status_macros.h"
#include "services/runtime/atomic_file.h"
#include "services/text/quote.h"

namespace rips::outputs {
namespace {

constexpr size_t kSecretBytesMax = 4'096;
// Of these the body is the reason: bad request, too large, of an unsupported type, unprocessable.
// Others, such as 401 or 404, are of a wrong secret or address, which an operator mends.
constexpr int kBodyRefused[] = {400, 413, 415, 422};

absl::Status ClassifyAnswer(const HttpAnswer& answer) {
  const int status = answer.status();
  if (status >= 200 && status < 300) return absl::OkStatus();
  std::string text = absl::StrCat("the receiver answered ", status);
  if (!answer.body().empty()) absl::StrAppend(&text, ": ", Quote(answer.body()));
  const bool refused =
      std::find(std::begin(kBodyRefused), std::end(kBodyRefused), status) != std::end(kBodyRefused);
  return refused ? absl::InvalidArgumentError(text) : absl::UnavailableError(text);
}

}  // namespace

std::string SignBody(absl::string_view secret, absl::string_view timestamp,
                     absl::string_view body) {
  const std::string text = absl::StrCat(timestamp, ".", body);
  unsigned char mac[EVP_MAX_MD_SIZE];
  unsigned int size = 0;
  if (HMAC(EVP_sha256(), secret.data(), static_cast<int>(secret.size()),
           reinterpret_cast<const unsigned char*>(text.data()), text.size(), mac,
           &size) == nullptr) {
    return "";
  }
  return absl::StrCat("sha256=", absl::BytesToHexString(
                                     absl::string_view(reinterpret_cast<const char*>(mac), size)));
}

std::string WebhookReceiver::FormatBody(std::span<const store::AlertRecord> alerts) const {
  std::string body;
  for (const store::AlertRecord& alert : alerts) {
    absl::StrAppend(&body, body.empty() ? "[" : ",",
                    config_.format == server::OutputConfig::Format::kOcsf
                        ? FormatOcsf(alert)
                        : store::FormatAlertLine(alert));
  }
  return absl::StrCat(body, "]");
}

absl::StatusOr<HttpHeaders> WebhookReceiver::Sign(absl::string_view body) const {
  if (config_.secret_file.empty()) return HttpHeaders();
  RIPS_ASSIGN_OR_RETURN(const std::string content, ReadFile(config_.secret_file, kSecretBytesMax));
  absl::string_view secret = content;
  absl::ConsumeSuffix(&secret, "\n");
  absl::ConsumeSuffix(&secret, "\r");
  if (secret.empty()) {
    return absl::FailedPreconditionError(absl::StrCat("`", config_.secret_file, "` is empty"));
  }
  const std::string timestamp = absl::StrCat(clock_->Now().unix_ns / kNanosPerSecond);
  const std::string signature = SignBody(secret, timestamp, body);
  if (signature.empty()) return absl::UnavailableError("cannot sign: no memory");
  return HttpHeaders{{"X-Rips-Timestamp", timestamp}, {"X-Rips-Signature", signature}};
}

absl::Status WebhookReceiver::Send(std::span<const store::AlertRecord> alerts) {
  const std::string body = FormatBody(alerts);
  RIPS_ASSIGN_OR_RETURN(const HttpHeaders headers, Sign(body));
  RIPS_ASSIGN_OR_RETURN(
      const HttpAnswer answer,
      Post(FormatPost(config_.endpoint.host, config_.endpoint.port, config_.path, headers, body)));
  return ClassifyAnswer(answer);
}

absl::StatusOr<HttpAnswer> WebhookReceiver::Post(absl::string_view request) {
  RIPS_ASSIGN_OR_RETURN(const std::unique_ptr<Connection> connection,
                        Connection::Open(config_.endpoint, timeouts_.connect, &stop_));
  // A receiver may answer before it has read all, and close: why is in its answer.
  const absl::Status sent = connection->Write(request, timeouts_.send);
  if (absl::IsCancelled(sent) || absl::IsDeadlineExceeded(sent)) return sent;
  const Deadline deadline(timeouts_.answer);
  HttpAnswer answer;
  while (!answer.done()) {
    const absl::StatusOr<std::string> bytes = connection->Read(HttpAnswer::kHeadBytesMax, deadline);
    if (!bytes.ok() || bytes->empty()) {
      // The head decides; the body only explains.
      if (answer.status() != 0) return answer;
      RIPS_RETURN_IF_ERROR(sent);
      RIPS_RETURN_IF_ERROR(bytes.status());
      return absl::UnavailableError("the receiver closed the connection without an answer");
    }
    RIPS_RETURN_IF_ERROR(answer.Feed(*bytes));
  }
  return answer;
}

}  // namespace rips::outputs
