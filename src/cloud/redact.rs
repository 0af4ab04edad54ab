//! Keeps credentials out of messages.
//!
//! Clients include the answers of servers and the addresses of requests in their errors. Servers repeat the requests,
//! and signatures may be part of addresses.

/// Nothing shorter is a secret; replacing it would only garble the message.
const LEAST_CHARS: usize = 6;

/// The text without the values of the environment's credentials, and without the queries of addresses.
pub(super) fn redacted(text: &str) -> String {
    let variables =
        std::env::vars_os().filter_map(|(name, value)| Some((name.into_string().ok()?, value.into_string().ok()?)));
    without_queries(&without_values(text, variables))
}

fn without_values(text: &str, variables: impl Iterator<Item = (String, String)>) -> String {
    let is_secret = |(name, value): &(String, String)| {
        let is_of_store = ["AWS_", "GOOGLE_"].iter().any(|prefix| name.starts_with(prefix));
        let is_told = ["KEY", "SECRET", "TOKEN", "PASSWORD"].iter().any(|word| name.contains(word));
        is_of_store && is_told && value.len() >= LEAST_CHARS
    };
    variables.filter(is_secret).fold(text.to_owned(), |text, (name, value)| text.replace(&value, &format!("<{name}>")))
}

/// Addresses end at the first `?`.
fn without_queries(text: &str) -> String {
    let mut kept = String::with_capacity(text.len());
    let mut rest = text;
    while let Some(at) = rest.find("://") {
        let end = rest[at..]
            .find(|c: char| c.is_whitespace() || matches!(c, '"' | ')' | '>' | '?'))
            .map_or(rest.len(), |end| at + end);
        kept.push_str(&rest[..end]);
        rest = &rest[end..];
        if rest.starts_with('?') {
            let end = rest.find(|c: char| c.is_whitespace() || matches!(c, '"' | ')' | '>')).unwrap_or(rest.len());
            kept.push_str("?…");
            rest = &rest[end..];
        }
    }
    kept + rest
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn secrets_of_the_environment_are_replaced_by_their_names() {
        let variables =
            [("AWS_SECRET_ACCESS_KEY", "hunter2hunter2"), ("AWS_REGION", "us-east-1"), ("MY_KEY", "hunter3")];
        let variables = variables.map(|(name, value)| (name.to_owned(), value.to_owned()));
        let text = without_values("got hunter2hunter2 in us-east-1, hunter3", variables.into_iter());
        assert_eq!(text, "got <AWS_SECRET_ACCESS_KEY> in us-east-1, hunter3");
    }

    #[test]
    fn addresses_lose_their_queries() {
        let text = "GET (https://a.blob.net/c/x?sig=abc%3D&se=1): 403? see http://b/ and \"http://c?d\" why?";
        assert_eq!(without_queries(text), "GET (https://a.blob.net/c/x?…): 403? see http://b/ and \"http://c?…\" why?");
    }
}
